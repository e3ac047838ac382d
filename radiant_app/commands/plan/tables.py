"""Tables of what `radiant plan` prints, as rows of plain values and as aligned text."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Any

from radiant_app.commands.plan.content import border_table
from radiant_app.commands.plan.flight import flight_table
from radiant_app.report.figure_words import figure_lines
from radiant_core.plan.baselines import ComparedPlan


def method_row(row: ComparedPlan) -> dict[str, Any]:
    """A method's figures as plain values."""
    return {
        "method": row.method,
        "makespan_s": row.makespan_s,
        "makespan_over_bound": row.over_bound,
        "cameras_in_no_region": row.num_orphans,
        "squared_distance_m2": row.squared_distance_m2,
        "iterations": len(row.history) - 1,
        "last_imbalance": row.history[-1],
    }


def plan_tables(result: dict[str, Any]) -> list[str]:
    """What was made of profiles of other trainings, which is then taken out of `result`, and the
    tables of `--compare`, `--slack-curve`, the borders and flights that it has, as text."""
    unit = result.get("unit", "m")
    tables = (
        ("methods", lambda rows: method_table(rows, unit)),
        ("slack_curve", lambda rows: slack_table(rows, unit)),
        ("borders", border_table),
        ("flight", flight_table),
    )
    costs = [result.pop("costs")] if "costs" in result else []
    return [*costs, *(aligned(result[name]) for name, aligned in tables if result.get(name))]


def next_flight_lines(result: dict[str, Any], run: Path) -> list[str]:
    """A map of what is known and the flight over it, if any, in lines with units, and what to do
    next."""
    lines = list(figure_lines(result))
    for row in result.get("flight", ()):
        trains = f", trained in {row['training_s']:g} s" if "training_s" in row else ""
        batteries = "battery" if row["batteries"] == 1 else "batteries"
        lines.append(f"{row['device']}: {row['views']} views, {row['flight_s'] / 60:.1f} min, {row['batteries']} {batteries}{trains}")
    folder = quote(str(run))
    then = f"join {folder} --photographs NEW" if "flight" in result else f"plan --next {folder} --photographs 13"
    return [*lines, f"next: {'fly, then ' * ('flight' in result)}radiant {then} --out OUT"]


def method_table(rows: list[dict[str, Any]], unit: str = "m") -> str:
    """The rows of `--compare`, aligned; lengths are in `unit`."""
    lines = [f"{'method':<14} {'makespan':>12} {'/ bound':>9} {'no region':>9} {'Σ distance²':>13} {'iterations':>10} {'imbalance':>9}"]
    lines += [
        f"{row['method']:<14} {row['makespan_s']:>10.1f} s {row['makespan_over_bound']:>9.4f} {row['cameras_in_no_region']:>9} "
        f"{row['squared_distance_m2']:>10.4g} {unit}² {row['iterations']:>10} {row['last_imbalance']:>9.3f}"
        for row in rows
    ]
    return "\n".join(lines)


def slack_table(rows: list[dict[str, Any]], unit: str = "m") -> str:
    """The rows of `--slack-curve`, aligned; lengths are in `unit`."""
    lines = [f"{'slack':>7} {'makespan':>12} {'mean distance':>14} {'rms distance':>13} {'borders':>11}"]
    lines += [
        f"{row['slack']:>7.3f} {row['makespan_s']:>10.1f} s {row['mean_distance_m']:>12.1f} {unit} {row['rms_distance_m']:>11.1f} {unit} "
        f"{row['border_m']:>9.0f} {unit}"
        for row in rows
    ]
    return "\n".join(lines)
