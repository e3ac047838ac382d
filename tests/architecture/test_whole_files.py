"""How tests are dealt to two workers: a file to one of them, those that share a session's fixture to one, short files last."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.whole_files import SHARED, pytest_collection_modifyitems

ROOT = Path(__file__).parents[2]
OF_RAY = SHARED["address"]
TESTS = """
import os, pathlib, pytest, time
@pytest.fixture(scope="module")
def made():
    with pathlib.Path(os.environ["MADE"]).open("a") as file:
        file.write(os.environ["PYTEST_XDIST_WORKER"] + " " + __file__ + chr(10))
@pytest.mark.parametrize("number", range({count}))
def test_it(made, number):
    time.sleep(0.02)
"""


def test_a_modules_fixture_is_made_once_and_files_that_share_go_to_one_worker(tmp_path: Path) -> None:
    # Dealt by test, the largest file would be split: it has more than half of them all.
    counts = {"tests/app/test_large.py": 40, "tests/viewer/test_window.py": 3}
    for name, count in (counts | dict.fromkeys(OF_RAY, 3)).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(TESTS.format(count=count))
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "-p", "tests.whole_files", "-p", "no:cacheprovider"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment |= {"MADE": str(tmp_path / "made.txt"), "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command += ["-p", "xdist", "--import-mode=importlib", "--rootdir", str(tmp_path), "tests"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in (tmp_path / "made.txt").read_text().splitlines()]
    workers = defaultdict(list)
    for worker, file in rows:
        workers[Path(file).relative_to(tmp_path).as_posix()].append(worker)
    assert {file: len(names) for file, names in workers.items()} == dict.fromkeys((*counts, *OF_RAY), 1)
    assert len({workers[file][0] for file in OF_RAY}) == 1 and len({worker for worker, _ in rows}) == 2


def test_short_files_come_last_and_all_others_as_they_were() -> None:
    items = [cast(Any, SimpleNamespace(nodeid=f"tests/{name}.py::test_it")) for name in ("core/b", "viewer/c", "core/a", "app/d")]
    pytest_collection_modifyitems(items)
    assert [item.nodeid.split(".")[0] for item in items] == ["tests/viewer/c", "tests/app/d", "tests/core/b", "tests/core/a"]


@pytest.mark.parametrize(
    ("fixture", "asked"),
    [("address", r"\baddress: str\b|\"address\""), ("finished", r"\bfinished: Finished\b"), ("paper_models", r"\bpaper_models: Path\b")],
)
def test_files_that_share_are_those_that_ask(fixture: str, asked: str) -> None:
    folder = (ROOT / SHARED[fixture][0]).parent
    asking = [path.relative_to(ROOT).as_posix() for path in sorted(folder.glob("test_*.py")) if re.search(asked, path.read_text())]
    assert asking == list(SHARED[fixture])
