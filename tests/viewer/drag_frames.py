"""What a frame of a border's drag costs in the real window: 2,000 cameras, 16 edges, solving,
report and drawing of the map included.

    xvfb-run -a -s "-screen 0 1280x800x24" env OMP_NUM_THREADS=1 python -m tests.viewer.drag_frames

Every frame's cells are checked to be convex and disjoint. CPU is told by thread: the window's own
waits for the others, so their sum, of the rasterizer's the longest, is what a frame takes on a free
machine.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PySide6.QtCore import QEventLoop, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from shapely.geometry import Polygon

from radiant_app.files.system_file import dump_system, even_system
from radiant_core.plan.borders.borders import shared_borders
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_viewer.editing.model.edited_plan import EditedPlan
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_user import LEFT, PATIENCE_S, pixel, use_window

NUM_EDGES, GRID = 16, (50, 40)
WARM, MEASURED, STEP_M = 3, 12, 1.0


def drag(window: InspectorWindow) -> None:
    """Drag the longest border and print what its frames took."""
    planning = window.planning
    assert planning is not None and planning.session is not None
    session = planning.session
    # The model's own process would share the cores.
    assert window.model is not None
    window.model.set_shown(False)
    planning.set_active(True)
    QTest.qWait(1000)
    border = max(shared_borders(session.editor.state.cloud), key=lambda one: one.length_m)
    start = border.ends.mean(axis=0) + 0.3 * border.toward_first
    plans: list[EditedPlan] = []
    session.previewed.connect(plans.append)
    QTest.mousePress(window.map.plotter, LEFT, pos=pixel(window.map, start))
    assert planning.tools.is_dragging, "the border was not grabbed"
    walls_s, before = [], {}
    for step in range(1, WARM + MEASURED + 1):
        if step == WARM + 1:
            before = cpu_s()
        began, seen = time.perf_counter(), len(plans)
        QTest.mouseMove(window.map.plotter, pixel(window.map, start + STEP_M * step * border.toward_first))
        if len(plans) == seen:
            # Waits without spinning, which would count as work.
            loop = QEventLoop()
            session.previewed.connect(loop.quit)
            QTimer.singleShot(1000 * PATIENCE_S, loop.quit)
            loop.exec()
            session.previewed.disconnect(loop.quit)
        QApplication.processEvents()
        assert len(plans) == seen + 1, "no frame of the drag came"
        walls_s.append(time.perf_counter() - began)
    after = cpu_s()
    for plan in plans:
        require_convex_and_disjoint(plan.cloud)
    spent = sorted(((after[name] - before.get(name, 0.0)) / MEASURED, name) for name in after)[::-1]
    print("; ".join(f"{name} {1000 * seconds:.0f} ms" for seconds, name in spent[:5]))
    total = sum(seconds for seconds, _ in spent)
    print(f"a frame: {1000 * total:.0f} ms CPU, {1000 * float(np.median(walls_s[WARM:])):.0f} ms wall at load {os.getloadavg()[0]:.1f}")
    QTest.mouseRelease(window.map.plotter, LEFT, pos=pixel(window.map, start))


def cpu_s() -> dict[str, float]:
    """Seconds that each kind of thread of this process ran, by name; the rasterizer's by number."""
    spent: dict[str, float] = defaultdict(float)
    for task in Path("/proc/self/task").iterdir():
        name = "window" if task.name == str(os.getpid()) else (task / "comm").read_text().strip()
        spent[name] += int((task / "schedstat").read_text().split()[0]) / 1e9
    return spent


def require_convex_and_disjoint(cloud: CloudPlan) -> None:
    """AssertionError where a region is not convex, or two of them share land."""
    cells = [Polygon(border) for border in cloud.borders if len(border) >= 3]
    land = sum(cell.area for cell in cells)
    for index, cell in enumerate(cells):
        assert cell.convex_hull.area - cell.area < 1e-9 * land, "a region is not convex"
        assert all(cell.intersection(other).area < 1e-9 * land for other in cells[:index]), "two regions share land"


def main() -> None:
    """A made-up run of its own."""
    town = made_up_town(grid=GRID)
    places = town.scene.cameras.centers[:, :2]
    system = place_edges(even_system(NUM_EDGES, 2), places, None, 0)
    cloud = plan_regions(places, system)
    assert isinstance(cloud, CloudPlan)
    with TemporaryDirectory() as temporary:
        run = Path(temporary) / "run"
        save_run(run, replace(town, cloud_plan=cloud, edge_plans=split_edges(places, cloud, system)))
        (run / "system.toml").write_text(dump_system(system))
        use_window(run, drag)


if __name__ == "__main__":
    main()
