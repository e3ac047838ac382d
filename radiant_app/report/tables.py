"""Tables of results on the terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import typer

from radiant_app.report.advice import what_to_try
from radiant_app.report.figure_words import WORDS, figure_lines
from radiant_app.report.verdict import verdict_of
from radiant_core.io.run_store import read_json

if TYPE_CHECKING:
    from rich.table import Table

FILE_WIDTH = 10_000
"""A table in a file is as wide as it needs to be; none is wider."""


def print_summary(result: Any) -> None:
    """One line per job of a batch."""
    from rich.table import Table

    table = Table("job", "status", "time (s)", "PSNR (dB)", "Gaussians", "result")
    for job in result.jobs:
        figures = [job.seconds, job.figures.get("psnr_db"), job.figures.get("num_gaussians")]
        texts = ["" if value is None else form.format(value) for form, value in zip(("{:.1f}", "{:.2f}", "{:,}"), figures, strict=True)]
        table.add_row(job.name, job.status, *texts, job.message or (job.out if job.exit_code == 0 else ""))
    _print(table)
    typer.echo(f"summary: {result.folder / 'summary.html'}")


def print_figures(result: dict[str, Any]) -> None:
    """One line per scored photograph, and their mean and median."""
    from rich.table import Table

    forms = {"psnr_db": "{:.2f}", "ssim": "{:.4f}", "psnr_cc_db": "{:.2f}", "ssim_cc": "{:.4f}", "flip": "{:.4f}", "lpips": "{:.4f}"}
    table = Table("photograph", *(f"{WORDS[figure]} (dB)" if figure.endswith("_db") else WORDS[figure] for figure in forms))
    for row in (*result["images"], {"name": "mean", **result}, {"name": "median", **result["median"]}):
        table.add_row(row["name"], *("" if row[figure] is None else form.format(row[figure]) for figure, form in forms.items()))
    _print(table)


def _print(table: Table) -> None:
    """A table within a terminal's width, in a file with nothing cut; names are no markup."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else FILE_WIDTH
    Console(width=width, markup=False, emoji=False).print(table, markup=False, emoji=False)


def print_model(path: Path, metrics: Mapping[str, Any]) -> None:
    """Where a finished model is, how good it is by `metrics` (metrics.json), and where it is poor
    what to try; decisions are read from the manifest beside it."""
    typer.echo(f"model: {path} ({metrics['num_gaussians']:,} Gaussians, {path.stat().st_size / 1e6:.1f} MB)")
    typer.echo(f"quality: {verdict_of(metrics).line}")
    for line in what_to_try(metrics, read_json(path.parent / "manifest.json", ("decisions",))["decisions"]):
        typer.echo(f"try: {line}")


def print_scene(result: Mapping[str, Any]) -> None:
    """What `commands.run.steps.sfm` found, and what to do next."""
    typer.echo(f"photographs: {result['cameras']} of {result['cameras'] + len(result['unregistered'])} placed")
    typer.echo(f"points: {result['points']:,}")
    residual_m = result["gps_residual_m"]
    from radiant_app.report.ground_control import positions_lines, survey_lines  # numpy

    survey = result.get("ground_control")
    of = "median distance to GPS" if survey is None else "RMS to camera positions, per axis,"
    typer.echo(f"frame: {result['frame']}" + ("" if residual_m is None else f", {of} {residual_m:.2f} m"))
    for line in positions_lines(result.get("gps_positions")):
        typer.echo(line)
    for line in () if survey is None else survey_lines(survey):
        typer.echo(line)
    folder = quote(str(result["folder"]))
    typer.echo(f"scene: {folder}\nnext: radiant train {folder} --out MODEL, or radiant inspect {folder}")


def finish(result: dict[str, Any], as_json: bool, words: Mapping[str, str] | None = None) -> None:
    """What a command prints: one JSON object, where sentences (a tuple) are one text, or a line per
    figure or sentence in words, `words` before the usual ones."""
    if as_json:
        typer.echo(json.dumps({key: " ".join(value) if isinstance(value, tuple) else value for key, value in result.items()}))
        return
    for line in figure_lines(result, words):
        typer.echo(line)
