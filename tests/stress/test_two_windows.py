"""Two real windows on one plan ask whose edits count, and one of them sees that its interrupted run goes on. Half a minute."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.viewer.made_up_run import EDGE_IDS, made_up_town, save_run
from tests.viewer.window_kit import display, run_python  # noqa: F401 (a fixture)

DRIVER = """
import sys, time
from pathlib import Path
from PySide6.QtCore import QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from radiant_app.files.event_file import EventFile
from radiant_app.events import StageProgress, StageStarted
from radiant_app.commands.inspect.window import run_setting
from radiant_app.commands.inspect.feeds import feeds_of
from radiant_core.io.run_store import RunLock, write_json
from radiant_viewer.window.inspector import open_window
from radiant_viewer.editing.model.plan_edits import LockRegion, MoveEdge
from radiant_viewer.window.subject import load_subject
from radiant_viewer.window.window import InspectorWindow

run, out = Path(sys.argv[1]), Path(sys.argv[2])
failures = []

def drive():
    try:
        first = next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, InspectorWindow))
        QTest.qWait(200)
        resumed(first)
        edited(first)
    except BaseException as error:
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()

def until(condition, what, seconds=20):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, what
        QTest.qWait(20)

def resumed(window):
    dock = window.docks.progress
    assert "interrupted" in dock.summary.text() and dock.table.item(0, 1).text() == "interrupted", dock.summary.text()
    with RunLock(run), EventFile(run, lambda event: None) as tell:
        write_json(run / "manifest.json", {"status": "running"})
        tell(StageStarted(stage="devices/north-1"))
        tell(StageProgress(stage="devices/north-1", done=1, total=4))
        until(lambda: "Run running" in dock.summary.text(), "the window never heard that the run goes on: " + dock.summary.text())
        assert dock.table.item(0, 1).text() == "running" and "goes on" in window.statusBar().currentMessage()
        write_json(run / "manifest.json", {"status": "done"})
    until(lambda: "Run done" in dock.summary.text(), "the window never heard that the run ended")

def edited(first):
    second = InspectorWindow(load_subject(run), feeds_of(run), "light", run_setting(run))
    second.show()
    QTest.qWait(200)
    one, two = first.planning, second.planning
    one.session.edit(LockRegion(edge="north"))
    until(lambda: one.session.editor.edits and not one.session.is_busy, "the first edit never came")
    until(lambda: not two.dock.conflict.isHidden(), "the second window never heard of the first one's edit")
    assert two.dock.isVisible() and "Another window" in second.statusBar().currentMessage()
    two.session.edit(MoveEdge(edge="harbour", position=(60.0, 20.0)))
    until(lambda: two.session.editor.edits and not two.session.is_busy, "the second edit never came")
    assert "plan_edits_1.json" in two.dock.conflict_text.text(), two.dock.conflict_text.text()
    assert one.dock.conflict.isHidden() and (run / "plan_edits.json").read_text().count("LockRegion") == 1
    QTest.qWait(300)
    second.grab().save(str(out / "conflict.png"))
    two.dock.buttons["Keep mine"].click()
    assert two.dock.conflict.isHidden() and "plan_edits_2.json" in second.statusBar().currentMessage()
    until(lambda: not one.dock.conflict.isHidden(), "the first window never heard that the second took over")
    one.dock.buttons["Take theirs"].click()
    assert one.dock.conflict.isHidden() and [type(edit) for edit in one.session.editor.edits] == [MoveEdge]
    assert first.run.cloud_plan.sites[1].tolist() == [60.0, 20.0], "the window shows its own plan still"

QTimer.singleShot(0, drive)
code = open_window(run, feeds_of(run), setting=lambda: run_setting(run))
assert not failures, failures
sys.exit(code)
"""


@pytest.mark.stress
def test_two_real_windows_ask_whose_edits_count_and_one_sees_a_run_go_on(tmp_path: Path, display: str) -> None:  # noqa: F811 (the fixture)
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    run = tmp_path / "run"
    save_run(run, made_up_town())
    lines = [f'[[edge]]\nid = "{edge}"\n' + "".join(f'[[edge.device]]\nid = "{edge}-{n}"\n' for n in (1, 2)) for edge in EDGE_IDS]
    (run / "system.toml").write_text("".join(lines))
    (run / "manifest.json").write_text('{"status": "interrupted"}')
    (run / "events.jsonl").write_text('{"event": "StageStarted", "stage": "devices/north-1"}\n')
    result = run_python(DRIVER, str(run), str(tmp_path), DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-3000:]
    assert (run / "plan_edits.json").read_text().count("MoveEdge") == 1
    assert (run / "plan_edits_2.json").read_text().count("LockRegion") == 1
