"""Figures are printed in words with units; `--json` keeps the keys."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

from radiant_app.report.figure_words import OF_GAUSSIANS, OF_POSITIONS, WORDS, figure_lines
from radiant_app.report.tables import finish

ROOT = Path(__file__).parents[2]
SOURCES = [*sorted((ROOT / "radiant_app/commands").rglob("*.py")), *sorted((ROOT / "core/radiant_core/export").glob("*.py"))]


def keys_of_results() -> set[str]:
    """Keys of the dictionaries that functions of commands return."""
    returned = [
        node.value
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Dict)
    ]
    return {key.value for each in returned for key in each.keys if isinstance(key, ast.Constant) and isinstance(key.value, str)}


def test_no_key_of_a_command_is_printed_bare() -> None:
    keys = keys_of_results()
    assert {"makespan_s", "gaussians", "known"} <= keys, "the test reads no results"
    lines = list(figure_lines(dict.fromkeys(sorted(keys | set(WORDS)), 2.0)))
    assert [line for line in lines if "_" in line] == []


def test_no_words_are_left_for_a_key_that_is_gone() -> None:
    texts = [path.read_text() for folder in ("radiant_app", "core/radiant_core") for path in (ROOT / folder).rglob("*.py")]
    text = "\n".join(text for text in texts if "WORDS: Mapping" not in text)
    # Put together of two words: holes and weak surface, on the ground and on walls.
    areas = {f"{name}_{on}" for name in ("hole", "weak") for on in ("ground", "walls")}
    names = {*WORDS, *OF_POSITIONS, *OF_GAUSSIANS} - areas
    assert [name for name in sorted(names) if not re.search(rf'"{name}"|^ +{name}: ', text, re.MULTILINE)] == []


def test_figures_have_words_units_and_digits_as_people_read_them() -> None:
    result = {
        "unit": "ft",
        "rank": 0.8471,
        "good": 0.896,
        "margin_db": 3.47,
        "error_cells": 5376,
        "hole_walls": 12345.67,
        "resolution": 0.61,
        "moved": 3,
        "filled": 0.1376,
        "bytes": 3446879,
        "long_side_px": 576,
        "no_data": -9999.0,
        "fewest_moves_proved": False,
        "warnings": "one. two.",
        "lpips": None,
        "rows": [1],
    }
    assert list(figure_lines(result, OF_POSITIONS)) == [
        "predicted errors, rank correlation with the true ones (1: the same order): 0.847",
        "predicted errors, cells at least as good as promised (90 % are meant): 89.6 %",
        "predicted errors, nine of ten cells at most so much worse: 3.47 dB",
        "predicted errors, judged in cells: 5,376",
        "walls that no photograph shows: 12,345.7 ft²",
        "side of a cell: 0.61 ft",
        "positions moved: 3",
        "share of cells filled in: 13.8 %",
        "size: 3.4 MB",
        "long side of the pictures: 576 px",
        "value of cells without a height: -9999",
        "proved to be the fewest moves: no",
    ]
    assert list(figure_lines({"training": ("one.", "two.")})) == ["training: one.", "training: two."]
    # A count under the name of a share is one.
    assert list(figure_lines({"filled": 1}, OF_GAUSSIANS)) == ["Gaussians filled: 1"]


def test_json_has_every_key_and_digit(capsys: pytest.CaptureFixture[str]) -> None:
    result = {"makespan_s": 63.32781686763339, "warnings": "none", "lpips": None, "unit": "m"}
    finish({**result, "training": ("one.", "two.")}, as_json=True)
    assert json.loads(capsys.readouterr().out) == {**result, "training": "one. two."}
