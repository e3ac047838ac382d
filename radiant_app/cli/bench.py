"""`radiant bench`: the door to `benchmarks/`, which lies in the source and is not installed."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import typer

from radiant_core.errors import BadInput

FORWARDED = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}
"""Settings of the command: every argument, --help among them, is the benchmarks' to read."""


def bench(context: typer.Context) -> None:
    """Run time beside error: the benchmarks of the source (benchmarks/README.md)."""
    source = Path(__file__).resolve().parents[2]
    if not (source / "benchmarks" / "cli.py").is_file():
        raise BadInput(
            "the benchmarks are in the source and no part of this installation: "
            "clone the repository, run ./setup.sh there and use its .venv/bin/radiant."
        )
    if str(source) not in sys.path:
        sys.path.append(str(source))
    code = importlib.import_module("benchmarks.cli").main(context.args)
    if code:
        raise typer.Exit(int(code))
