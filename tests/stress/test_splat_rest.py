"""The splat view of the real window comes to rest at every size of it: a full picture, and nothing more is asked. A minute or two."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import run_python, virtual_display

SIZES_WH = ((1280, 781), (1280, 800), (1920, 1061), (1024, 600))
DRIVER = """
import json, sys, time
from pathlib import Path
from PySide6.QtCore import QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from radiant_viewer.splats import splat_process
from radiant_viewer.window.inspector import open_window
from radiant_viewer.window.window import InspectorWindow

run, sizes, out = Path(sys.argv[1]), json.loads(sys.argv[2]), Path(sys.argv[3])
failures, asked, found = [], [], []
ask = splat_process.SplatProcess.ask
splat_process.SplatProcess.ask = lambda *arguments: (asked.append(arguments[2].sizes_wh[0].tolist()), ask(*arguments))[1]

def until(condition, what, seconds):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, what
        QTest.qWait(50)

def drive():
    try:
        window = next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, InspectorWindow))
        model = window.model
        for width, height in sizes:
            window.resize(width, height)
            QTest.qWait(6000)
            before, picture = len(asked), window.view.size_wh
            QTest.qWait(4000)
            found.append([[width, height], model.shown_is_full, len(asked) - before, window.view.size_wh == picture])
            window.save_window_picture(out / f"splats_{width}x{height}.png")
    except BaseException as error:
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()

QTimer.singleShot(0, drive)
code = open_window(run)
assert not failures, failures
print(json.dumps(found))
"""


@pytest.mark.stress
@pytest.mark.parametrize(("scale", "sizes_wh"), [("1", SIZES_WH), ("2", SIZES_WH[-1:])])
def test_the_picture_is_full_and_nothing_is_asked_for_at_rest(tmp_path: Path, scale: str, sizes_wh: tuple[tuple[int, int], ...]) -> None:
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(tmp_path / "run", made_up_town(step_levels=40))
    sizes = json.dumps(sizes_wh)
    with virtual_display("2560x1600x24") as display:
        environment = {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb", "QT_SCALE_FACTOR": scale}
        result = run_python(DRIVER, str(tmp_path / "run"), sizes, str(tmp_path), **environment)
    assert result.returncode == 0, result.stderr[-3000:]
    found = json.loads(result.stdout.splitlines()[-1])
    assert found == [[list(size), True, 0, True] for size in sizes_wh]
