"""What stands beside a plan: names of its files, and its pictures besides the map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from radiant_app.report.prediction_error import curves_note, gantt_rows
from radiant_core.numerics import FloatArray
from radiant_core.plan.baselines import ComparedPlan
from radiant_core.plan.counts.slack_curve import SlackPoint
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import System

if TYPE_CHECKING:
    from radiant_viewer.pictures.images import Image

MAP, GANTT, METHODS, SLACKS = ".png", "_gantt.png", "_methods.png", "_slack.png"
LISTS, REGIONS, SYSTEM = "_waypoints", "_regions.geojson", "_system.toml"
ENDINGS = (MAP, GANTT, METHODS, SLACKS, LISTS, REGIONS, SYSTEM)


def sibling(out: Path, ending: str) -> Path:
    """The file or folder of a plan at `out` with that ending."""
    return out.with_name(f"{out.stem}{ending}")


def plan_gantt(system: System, edges: Sequence[EdgePlan]) -> Image:
    """What each machine will do when, by the curves of the system as planned."""
    from radiant_viewer.charts.gantt_chart import gantt_picture

    return gantt_picture(gantt_rows(system, edges), "Predicted stages", curves_note(system))


def side_pictures(
    positions: FloatArray, unit: str, cloud: CloudPlan, compared: Sequence[ComparedPlan], curve: Sequence[SlackPoint]
) -> dict[str, Image]:
    """Ending → picture: the methods compared on positions (P,2), and what slacks buy."""
    pictures: dict[str, Image] = {}
    if compared:
        pictures[METHODS] = _methods_picture(positions, unit, cloud, compared)
    if curve:
        from radiant_viewer.charts.slack_chart import slack_picture

        pictures[SLACKS] = slack_picture(tuple(curve), unit)
    return pictures


def _methods_picture(positions: FloatArray, unit: str, cloud: CloudPlan, compared: Sequence[ComparedPlan]) -> Image:
    from radiant_viewer.charts.partition_chart import Partition, partitions_picture
    from radiant_viewer.layers.region_layer import duration_text

    partitions = [
        Partition(name=row.method, edge_of_camera=row.edge_of_camera, edge_time_s=row.edge_time_s, note=f"{row.over_bound:.3g} × the bound")
        for row in compared
    ]
    title = f"Methods compared   ·   geography-free bound {duration_text(cloud.lower_bound_s)}"
    return partitions_picture(positions, partitions, cloud.edge_ids, title, unit)
