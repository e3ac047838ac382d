"""The examples run as they stand, small, and each makes the picture that it promises."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
from pathlib import Path

import cv2
import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from tests.forked import run_module

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("0*.py"))
MAX_LINES = 40
BLANK = "tests.app.blank_process"
NOTEBOOK = ROOT / "examples/plan_model_seams.ipynb"
CELLS = f"""
import json, pathlib, {BLANK}
import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
names = {{}}
for cell in json.loads(pathlib.Path({str(NOTEBOOK)!r}).read_text())["cells"]:
    if cell["cell_type"] == "code":
        exec("".join(cell["source"]), names)
for number in plt.get_fignums():
    canvas = plt.figure(number).canvas
    canvas.draw()
    print("spread", np.std(np.asarray(canvas.buffer_rgba())[..., :3]))
"""
"""Runs the notebook's cells one after another, and prints how much each figure shows."""


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("examples")


def test_there_are_eight_short_ones_and_the_page_names_them() -> None:
    page = (ROOT / "examples/README.md").read_text()
    assert [path.name[:2] for path in EXAMPLES] == [f"{number:02}" for number in range(1, 9)]
    assert all(len(path.read_text().splitlines()) <= MAX_LINES and f"`{path.name}`" in page for path in EXAMPLES)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_makes_its_picture(path: Path, hamlet_scene: Path, hamlet_project: Path, out: Path) -> None:
    # The hamlet with known cameras stands for the town.
    environment = {**os.environ, "OUT": str(out), "SCENE": str(hamlet_scene), "PHOTOGRAPHS": str(hamlet_project), "SMALL": "1"}
    if path == EXAMPLES[0]:
        environment["PYTHONPATH"] = str(ROOT)
        result = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, env=environment, timeout=600, check=False)
    else:  # The others are forks of a process that has imported the libraries, and leave pictures of reports blank.
        code = f"import runpy, sys, {BLANK}; sys.path.insert(0, {str(path.parent)!r}); runpy.run_path({str(path)!r}, run_name='__main__')"
        result = run_module("tests.run_code", "-c", code, cwd=ROOT, environment=environment, timeout_s=600)
    assert result.returncode == 0, result.stderr[-3000:]
    picture = cv2.imread(str(out / f"{path.stem}.png"))
    # A picture of something: neither missing nor of one colour.
    assert picture is not None and float(np.std(picture)) > 5


def test_the_cells_of_the_notebook_show_plan_model_and_seams(hamlet_project: Path, out: Path) -> None:
    environment = {**os.environ, "OUT": str(out / "cells"), "PHOTOGRAPHS": str(hamlet_project), "SMALL": "1"}
    result = run_module("tests.run_code", "-c", CELLS, cwd=ROOT, environment=environment, timeout_s=600)
    assert result.returncode == 0, result.stderr[-3000:]
    spreads = [float(line.split()[1]) for line in result.stdout.splitlines() if line.startswith("spread ")]
    assert len(spreads) == 3 and min(spreads) > 5


def test_the_notebook_has_no_outputs() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "clear the outputs before it is committed"


@pytest.mark.stress
def test_the_notebook_shows_plan_model_and_seams_inline(hamlet_project: Path, out: Path, tmp_path: Path) -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    startup = tmp_path / "profile_default" / "startup"
    startup.mkdir(parents=True)
    (startup / "blank.py").write_text(f"import {BLANK}\n")
    environment = {**os.environ, "OUT": str(out), "PHOTOGRAPHS": str(hamlet_project), "SMALL": "1", "PYTHONPATH": str(ROOT)}
    environment["IPYTHONDIR"] = str(tmp_path)
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(ROOT / "examples")}}).execute(
        env=environment
    )
    pictures = [output for cell in notebook.cells for output in cell.get("outputs", ()) if "image/png" in output.get("data", {})]
    assert len(pictures) == 3
    for output in pictures:
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(output["data"]["image/png"]), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None and float(np.std(picture)) > 5
