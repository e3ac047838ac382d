"""Power and false alarms of the seam measure: `python -m benchmarks.seam_excess SCENE…`.

Per scene and placement of the edges' borders: the plain cut, where the seam is known to be, joined
models, and the centralised model, which has none, at the same borders. Models are cached.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.methods.bench import METHODS
from benchmarks.methods.cells import BenchScene, Cell, ModelCache, bench_settings, deal_cell, layout_of, load_bench_scene
from radiant_core.errors import BadInput
from radiant_core.evaluate.seam_excess import SeamExcess, border_errors, pooled_excess
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats

LONG_SIDE_PX, NUM_STEPS = 384, 500
UNCUT = "centralised"
ARMS = (UNCUT, "crop", "ours")


@dataclass(frozen=True, kw_only=True)
class SeamRow:
    """The measure of one model at the borders of one cell."""

    cell: str
    arm: str
    excess: SeamExcess

    @property
    def line(self) -> str:
        """As a row of a table."""
        excess = self.excess
        if excess.excess_db is None or excess.at_least_db is None:
            return f"| {self.cell} | {self.arm} | – | – | 0 | {excess.reason} |"
        figures = f"{excess.excess_db:+.2f} | {excess.at_least_db:+.2f} | {excess.num_photographs}"
        return f"| {self.cell} | {self.arm} | {figures} | {'found' if excess.has_seam else ''} |"


def model_excess(splats: Splats, cell: Cell) -> SeamExcess:
    """The measure of a model over the cell's training photographs and borders."""
    views = cell.scene.views
    photographs = (image / np.float32(255) for image in views.images)
    return pooled_excess(border_errors(views.cameras, render_views(splats, views.cameras), photographs, cell.recipe.cloud_plan))


def measure_cells(cells: Sequence[Cell]) -> Iterator[SeamRow]:
    """Every arm at every placement of one scene and seed; the uncut model is that of the first."""
    for cell in cells:
        for name in ARMS:
            of = cells[0] if name == UNCUT else cell
            model = METHODS[name].make(of, METHODS[name].recipe(of))
            assert model.splats is not None, "all of them are of Gaussians"
            yield SeamRow(cell=cell.name, arm=name, excess=model_excess(model.splats, cell))


def deal_cells(scene: BenchScene, cache: ModelCache, layout: str, seed: int, num_placements: int) -> list[Cell]:
    """One scene and seed at several placements of the edges."""
    settings, dealt = bench_settings(LONG_SIDE_PX, NUM_STEPS), layout_of(layout)
    if dealt is None:
        raise BadInput("borders are placed anew here: give a layout such as 2x2.")
    settings = replace(settings, train=replace(settings.train, seed=seed))
    return [deal_cell(scene, cache, settings, dealt, placement) for placement in range(num_placements)]


def restrict_training(scene: BenchScene, count: int | None) -> BenchScene:
    """The scene with the `count` training photographs nearest to its middle; all for None."""
    if count is None:
        return scene
    places = scene.training.cameras.centers[:, :2]
    nearest = np.argsort(np.linalg.norm(places - np.median(places, axis=0), axis=1), kind="stable")[:count]
    return replace(scene, name=f"{scene.name}-{count}", training=scene.training.restricted_to(np.sort(nearest)))


def main(
    scenes: Annotated[list[Path], typer.Argument(help="Folders of `radiant sfm`.")],
    out: Annotated[Path, typer.Option(help="Folder of the trained models.")],
    layout: Annotated[str, typer.Option(help="Edges x devices.")] = "2x2",
    placements: Annotated[int, typer.Option(min=1, help="Placements of the edges.")] = 3,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of all trainings.")] = 1,
    photographs: Annotated[int | None, typer.Option(min=8, help="Training photographs; else all.")] = None,
) -> None:
    """Print a line per model and, at the end, how often a seam was found."""
    cache, rows = ModelCache(folder=out / "models"), []
    for source in scenes:
        scene = restrict_training(load_bench_scene(source, LONG_SIDE_PX), photographs)
        for seed in range(seeds):
            for row in measure_cells(deal_cells(scene, cache, layout, seed, placements)):
                typer.echo(row.line)
                rows.append(row)
    for name in ARMS:
        excesses = [row.excess for row in rows if row.arm == name and row.excess.excess_db is not None]
        typer.echo(f"{name}: found at {sum(bool(excess.has_seam) for excess in excesses)} of {len(excesses)}")


if __name__ == "__main__":
    typer.run(main)
