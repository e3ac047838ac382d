"""Two windows on one plan keep each other's edits; a window on a resumed run sees it go on."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from radiant_viewer.editing.model.plan_edits import Edit, LockRegion, MoveEdge, PinCameras
from radiant_viewer.editing.solver.plan_editor import PlanEditor
from radiant_viewer.editing.store.edit_file import load_edits, plan_key
from tests.viewer.test_plan_editor import editor_of
from tests.viewer.window_kit import run_python

FIRST, SECOND = LockRegion(edge="edge-1"), MoveEdge(edge="edge-2", position=(90.5, 40.25))


def edits_in(path: Path, editor: PlanEditor) -> list[Edit]:
    return list(load_edits(path, plan_key(editor.base.cloud, editor.base.edges))[0].edits)


def two_editors(folder: Path) -> tuple[PlanEditor, PlanEditor, Path]:
    """Both opened before either has changed anything, then each made an edit."""
    path = folder / "edits.json"
    first, second = editor_of(path), editor_of(path)
    for editor in (first, second):
        assert editor.restore() == ()
    first.apply(FIRST)
    second.apply(SECOND)
    return first, second, path


def test_the_second_window_that_edits_neither_overwrites_nor_loses(tmp_path: Path) -> None:
    first, second, path = two_editors(tmp_path)
    assert edits_in(path, first) == [FIRST], "the last writer won"
    beside = tmp_path / "edits_1.json"
    assert edits_in(beside, second) == [SECOND]
    assert first.conflict == "" and first.find_conflict() == ""
    assert "Another window" in second.conflict and beside.name in second.conflict
    # Both go on; each in its own file.
    first.undo()
    second.apply(PinCameras(cameras=second.subject.names[:2], edge="edge-1"))
    assert [len(edits_in(file, first)) for file in (path, beside)] == [0, 2]


def test_the_same_bytes_at_another_time_are_no_change(tmp_path: Path) -> None:
    path = tmp_path / "edits.json"
    editor = editor_of(path)
    editor.apply(FIRST)
    path.write_bytes(path.read_bytes())
    assert editor.find_conflict() == ""
    stat = path.stat()
    data = path.read_bytes()
    changed = data.replace(b'"edge-1"', b'"edge-3"')
    path.write_bytes(changed)
    # As long and as old as it was: only the bytes tell.
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert path.stat().st_size == stat.st_size
    assert "Another window" in editor.find_conflict()
    editor.undo()
    assert path.read_bytes() == changed


def test_taking_over_keeps_the_others_edits_beside_and_tells_the_other(tmp_path: Path) -> None:
    first, second, path = two_editors(tmp_path)
    (sentence,) = second.take_over()
    assert edits_in(path, second) == [SECOND] and second.conflict == ""
    (beside,) = [file for file in tmp_path.glob("edits_*.json") if file.name in sentence]
    assert edits_in(beside, first) == [FIRST]
    assert len(list(tmp_path.iterdir())) == 2, "a copy was left behind"
    assert "Another window" in first.find_conflict()
    first.apply(SECOND)
    assert edits_in(path, second) == [SECOND]
    assert sorted(len(edits_in(file, first)) for file in tmp_path.glob("edits_*.json")) == [1, 2]


def test_taking_theirs_shows_their_plan_and_keeps_mine_beside(tmp_path: Path) -> None:
    first, second, path = two_editors(tmp_path)
    (sentence,) = second.adopt_other()
    assert "edits_1.json" in sentence and second.conflict == ""
    assert second.edits == first.edits
    assert second.state.wishes.constraints.locked == ("edge-1",)
    assert edits_in(tmp_path / "edits_1.json", second) == [SECOND]
    second.apply(SECOND)
    assert edits_in(path, second) == [FIRST, SECOND]


RESUMED = """
import sys
from pathlib import Path
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from radiant_viewer.runs.run_feeds import RunFeeds, RunProgress, StageState
from radiant_viewer.window.waiting_window import WaitingWindow

now = ["interrupted"]
def progress():
    return RunProgress(stages=(StageState(stage="sfm", state=now[0]),), is_running=now[0] == "running", status=now[0])

application = QApplication([])
window = WaitingWindow(Path(sys.argv[1]), RunFeeds(progress=progress), "light")
seen = []
for state in ("interrupted", "running", "interrupted"):
    now[0] = state
    for _ in range(60):
        QTest.qWait(50)
        if f"Run {state}" in window.progress.summary.text() and ("ended" in window.text.text()) == (state != "running"):
            break
    seen.append((window.progress.summary.text().split()[1], window.progress.table.item(0, 1).text(), "ended" in window.text.text()))
window.close()
print(seen)
"""


def test_a_window_on_an_interrupted_run_sees_that_it_was_resumed(tmp_path: Path) -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    result = run_python(RESUMED, str(tmp_path), QT_QPA_PLATFORM="offscreen")
    assert result.returncode == 0, result.stderr[-2000:]
    ended, at_work = ("interrupted", "interrupted", True), ("running", "running", False)
    assert result.stdout.strip() == str([ended, at_work, ended])
