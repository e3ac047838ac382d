"""The editing model, without a window: laws of edits, undo, constraints, edits in a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon

from radiant_app.files.system_file import even_system
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan, load_plan_waypoints
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System
from radiant_viewer.editing.model.edited_plan import PlanSubject, border_weight_m2
from radiant_viewer.editing.model.plan_difference import plan_difference
from radiant_viewer.editing.model.plan_edits import (
    AddDevice,
    AddEdge,
    AdoptPlan,
    Edit,
    FixWeight,
    FreeRegion,
    LockRegion,
    MoveEdge,
    PinCameras,
    ReleaseAll,
    RemoveDevice,
    RemoveEdge,
    SetSlack,
    apply_edit,
)
from radiant_viewer.editing.solver.plan_editor import PlanEditor
from radiant_viewer.editing.store.edit_file import EditHistory, edit_record, load_edits, parse_edit, plan_key, save_edits
from radiant_viewer.editing.store.plan_files import PlanSetting, load_other_plan, save_edited_plan

Plan = tuple[CloudPlan, tuple[EdgePlan, ...]]
UTM = (5.0e5, 5.2e6)


def planned(num_cameras: int = 120, num_edges: int = 4, shift: tuple[float, float] = (0.0, 0.0)) -> tuple[PlanSubject, System, Plan]:
    rng = np.random.default_rng(5)
    positions = np.column_stack([rng.uniform(0, 400, num_cameras), rng.uniform(0, 300, num_cameras), rng.uniform(50, 60, num_cameras)])
    positions[:, :2] += shift
    subject = PlanSubject(names=tuple(f"{index:04d}.jpg" for index in range(num_cameras)), positions=positions)
    system = place_edges(even_system(num_edges, 2), subject.on_map, None, 0)
    cloud = plan_regions(subject.on_map, system)
    assert isinstance(cloud, CloudPlan)
    return subject, system, (cloud, split_edges(subject.on_map, cloud, system))


def editor_of(edits_path: Path | None = None, **options: object) -> PlanEditor:
    subject, system, plan = planned(**options)  # type: ignore[arg-type]
    return PlanEditor(subject, system, plan, edits_path)


def drag(editor: PlanEditor, edge: str, other: str, distance: float) -> FixWeight:
    return FixWeight(edge=edge, weight_m2=border_weight_m2(editor.state.cloud, edge, other, distance))


def same(first: Plan, second: Plan) -> bool:
    return plan_key(*first) == plan_key(*second)


def require_sound(editor: PlanEditor) -> None:
    """Both levels deal all cameras; cells are convex, disjoint and cover one rectangle."""
    state = editor.state
    require_plan_of(len(editor.subject.names), state.cloud, state.edges)
    low = np.concatenate(state.cloud.borders).min(axis=0)
    cells = [Polygon(border - low) for border in state.cloud.borders if len(border)]
    for cell in cells:
        assert cell.convex_hull.area == pytest.approx(cell.area, rel=1e-9)
    hull = cells[0].union(cells[0])
    for cell in cells[1:]:
        hull = hull.union(cell.buffer(1e-6))
    # Disjoint and covering: areas add up to the area of all, which is that of their hull.
    assert sum(cell.area for cell in cells) == pytest.approx(hull.convex_hull.area, rel=1e-5)


def owners(editor: PlanEditor) -> np.ndarray:
    return np.array(editor.state.cloud.edge_ids)[editor.state.cloud.edge_of_camera]


@pytest.mark.parametrize("shift", [(0.0, 0.0), UTM])
def test_every_edit_gives_a_sound_plan_and_undo_gives_back_the_same_bits(shift: tuple[float, float]) -> None:
    editor = editor_of(shift=shift)
    corner = np.concatenate(editor.state.cloud.borders).min(axis=0)
    edits: list[Edit] = [
        MoveEdge(edge="edge-2", position=(float(corner[0]) + 90, float(corner[1]) + 40)),
        SetSlack(slack=1.2),
        SetSlack(slack=None),
        drag(editor, "edge-1", "edge-2", 25.0),
        PinCameras(cameras=editor.subject.names[:5], edge="edge-3"),
        LockRegion(edge="edge-4"),
        AddEdge(edge="new", position=(float(corner[0]) + 200, float(corner[1]) + 150), like="edge-1"),
        AddDevice(edge="new", device="new-3", like="edge-2-1"),
        RemoveDevice(device="edge-3-1"),
        RemoveEdge(edge="edge-2"),
        FreeRegion(edge="edge-4"),
        ReleaseAll(),
    ]
    keys = [plan_key(editor.state.cloud, editor.state.edges)]
    for edit in edits:
        editor.apply(edit)
        require_sound(editor)
        keys.append(plan_key(editor.state.cloud, editor.state.edges))
    assert len(set(keys)) > 8
    for key in keys[-2::-1]:
        editor.undo()
        assert plan_key(editor.state.cloud, editor.state.edges) == key
    assert editor.undo_text == ""
    with pytest.raises(BadInput, match="nothing to undo"):
        editor.undo()
    for key in keys[1:]:
        editor.redo()
        assert plan_key(editor.state.cloud, editor.state.edges) == key
    with pytest.raises(BadInput, match="nothing to redo"):
        editor.redo()


def test_a_dragged_border_moves_as_far_as_the_pointer_and_the_rest_is_dealt_anew() -> None:
    editor = editor_of(num_edges=2)
    cloud = editor.state.cloud
    toward = (cloud.sites[1] - cloud.sites[0]) / np.linalg.norm(cloud.sites[1] - cloud.sites[0])

    def place(plan: CloudPlan) -> float:
        """Where the border cuts the way from the first edge to the second, metres."""
        apart = float(np.linalg.norm(plan.sites[1] - plan.sites[0]))
        return apart / 2 + float(plan.weights[0] - plan.weights[1]) / (2 * apart)

    editor.apply(drag(editor, "edge-1", "edge-2", 30.0))
    # It is drawn midway between the cameras it parts, which stand 3 m apart along the way on
    # average.
    assert place(editor.state.cloud) - place(cloud) == pytest.approx(30, abs=3)
    # Independent of the planner: the cameras on the near side of the moved line.
    along = (editor.subject.on_map - cloud.sites[0]) @ toward
    np.testing.assert_array_equal(owners(editor) == "edge-1", along <= place(cloud) + 30)
    assert editor.state.cloud.counts[0] > cloud.counts[0]
    report = editor.changes_since_last_edit
    assert int(report.new_edge.sum()) == editor.state.cloud.counts[0] - cloud.counts[0]
    assert report.flows == (("edge-2", "edge-1", int(report.new_edge.sum())),)
    assert "edge-2 → edge-1" in report.text and "makespan" in report.text


def test_with_more_edges_a_dragged_region_has_its_cell_and_the_others_stay_balanced() -> None:
    editor = editor_of(num_edges=4)
    edit = drag(editor, "edge-1", "edge-2", 40.0)
    preview = apply_edit(editor.subject, editor.state, edit, strips=False)
    assert preview.edges == () and editor.edits == ()
    editor.apply(edit)
    np.testing.assert_array_equal(preview.cloud.edge_of_camera, editor.state.cloud.edge_of_camera)
    others = editor.state.cloud.counts[1:]
    assert others.max() - others.min() <= 1  # equal machines
    assert editor.state.cloud.weights[0] == edit.weight_m2


def test_locked_and_pinned_cameras_stay_through_every_other_edit() -> None:
    editor = editor_of(num_edges=4)
    locked = set(np.flatnonzero(owners(editor) == "edge-4").tolist())
    pinned = [name for index, name in enumerate(editor.subject.names) if index not in locked][:6]
    editor.apply(LockRegion(edge="edge-4"))
    editor.apply(PinCameras(cameras=tuple(pinned), edge="edge-2"))
    for edit in (
        MoveEdge(edge="edge-4", position=(10.0, 10.0)),
        drag(editor, "edge-1", "edge-3", 30.0),
        AddEdge(edge="new", position=(200.0, 100.0), like="edge-1"),
        RemoveEdge(edge="edge-3"),
        RemoveDevice(device="edge-2-2"),
    ):
        editor.apply(edit)
        assert set(np.flatnonzero(owners(editor) == "edge-4").tolist()) == locked
        assert {owners(editor)[editor.subject.names.index(name)] for name in pinned} == {"edge-2"}
    editor.apply(PinCameras(cameras=tuple(pinned[:2]), edge=None))
    assert len(editor.state.wishes.constraints.pinned) == 4


def test_what_cannot_be_is_one_sentence_and_changes_nothing(tmp_path: Path) -> None:
    editor = editor_of(tmp_path / "edits.json", num_edges=2)
    editor.apply(LockRegion(edge="edge-1"))
    before, file = plan_key(editor.state.cloud, editor.state.edges), (tmp_path / "edits.json").read_bytes()
    position = (float("nan"), 0.0)
    for edit, words in (
        (LockRegion(edge="edge-1"), "locked already"),
        (drag(editor, "edge-1", "edge-2", 10.0), "is locked"),
        (FixWeight(edge="edge-2", weight_m2=float("nan")), "expected a finite number"),
        (FixWeight(edge="edge-2", weight_m2=1e300), "expected a finite number"),
        (drag(editor, "edge-2", "edge-1", -200.0), "free an edge"),
        (MoveEdge(edge="edge-2", position=position), "not finite"),
        (MoveEdge(edge="edge-2", position=(1e12, 0.0)), "from the origin"),
        (MoveEdge(edge="none", position=(0.0, 0.0)), "there is no edge 'none'"),
        (PinCameras(cameras=("none.jpg",), edge="edge-1"), "none of the 120 planned cameras"),
        (PinCameras(cameras=(), edge="edge-1"), "no camera is selected"),
        (SetSlack(slack=1.1), "slack is for a plan in which nothing is fixed"),
        (RemoveEdge(edge="edge-2"), "locked"),
        (AddEdge(edge="edge-1", position=(0.0, 0.0), like="edge-2"), "already"),
        (AddEdge(edge="a b", position=(0.0, 0.0), like="edge-2"), "cannot name a folder"),
        (AddDevice(edge="edge-1", device="x", like="none"), "no device 'none'"),
        (RemoveDevice(device="none"), "no device 'none'"),
        (FreeRegion(edge="edge-2"), "free already"),
    ):
        with pytest.raises(BadInput, match=words) as caught:
            editor.apply(edit)
        assert str(caught.value).count("\n") == 0
        assert plan_key(editor.state.cloud, editor.state.edges) == before
        assert (tmp_path / "edits.json").read_bytes() == file
    with pytest.raises(BadInput, match="only edge"):
        editor_of(num_edges=1).apply(RemoveEdge(edge="edge-1"))


def test_edits_are_kept_and_done_again_at_the_next_opening(tmp_path: Path) -> None:
    path = tmp_path / "edits.json"
    editor = editor_of(path)
    editor.apply(MoveEdge(edge="edge-2", position=(90.5, 40.25)))
    editor.apply(PinCameras(cameras=editor.subject.names[3:9], edge="edge-1"))
    editor.apply(drag(editor, "edge-3", "edge-1", 12.0))
    reached = plan_key(editor.state.cloud, editor.state.edges)
    editor.undo()
    again = editor_of(path)
    assert again.restore() == ()
    assert again.edits == editor.edits and again.redo_text == editor.redo_text
    assert same((again.state.cloud, again.state.edges), (editor.state.cloud, editor.state.edges))
    again.redo()
    assert plan_key(again.state.cloud, again.state.edges) == reached


def test_an_edit_that_was_being_solved_when_the_window_closed_is_not_lost(tmp_path: Path) -> None:
    path = tmp_path / "edits.json"
    editor = editor_of(path)
    editor.apply(LockRegion(edge="edge-1"))
    editor.begin(MoveEdge(edge="edge-2", position=(90.0, 40.0)))  # and never finished
    again = editor_of(path)
    assert again.restore() == ()
    assert [type(edit) for edit in again.edits] == [LockRegion, MoveEdge]
    # One that turns out to be impossible is told of, the others stay.
    again.begin(RemoveDevice(device="none"))
    last = editor_of(path)
    assert ["no device 'none'" in sentence for sentence in last.restore()] == [True]
    assert last.edits == again.edits


def test_kept_edits_of_another_plan_or_broken_ones_are_set_aside(tmp_path: Path) -> None:
    path = tmp_path / "edits.json"
    editor_of(path).apply(LockRegion(edge="edge-1"))
    kept = path.read_bytes()
    other = editor_of(path, num_edges=3)
    assert "made on another plan" in other.restore()[0]
    assert (tmp_path / "edits_1.json").read_bytes() == kept
    for content in (
        b"",
        b"{}",
        b'{"schema": 1}',
        kept.replace(b"LockRegion", b"Explode"),
        kept.replace(b"edge-1", b"edge-1\xff"),
        b"[" * 2000,
    ):
        path.write_bytes(content)
        told = editor_of(path).restore()
        assert len(told) == 1 and "cannot be read" in told[0], content[:60]
        assert not path.exists()
    editor = editor_of(tmp_path / "nowhere" / "edits.json")
    editor.apply(LockRegion(edge="edge-1"))
    assert editor.save_error.startswith("Edits are not kept:") and len(editor.edits) == 1


def test_every_kind_of_edit_is_written_and_read_back(tmp_path: Path) -> None:
    _, _, plan = planned(num_cameras=9, num_edges=2)
    edits: tuple[Edit, ...] = (
        FixWeight(edge="e", weight_m2=0.1 + 0.2),
        LockRegion(edge="e"),
        FreeRegion(edge="e"),
        PinCameras(cameras=("a", "b"), edge=None),
        MoveEdge(edge="e", position=(UTM[0] + 1e-9, -0.0)),
        AddEdge(edge="f", position=(1.0, 2.0), like="e"),
        RemoveEdge(edge="f"),
        AddDevice(edge="e", device="d", like="c"),
        RemoveDevice(device="d"),
        SetSlack(slack=None),
        SetSlack(slack=1.25),
        ReleaseAll(),
    )
    adopted = AdoptPlan(name="other", cloud=plan[0], edges=plan[1])
    save_edits(tmp_path / "e.json", "k", EditHistory(edits=(*edits, adopted)))
    kept, told = load_edits(tmp_path / "e.json", "k")
    assert told == "" and kept.edits[:-1] == edits
    last = kept.edits[-1]
    assert isinstance(last, AdoptPlan) and same((last.cloud, last.edges), plan)
    for record in (
        None,
        3,
        {"edit": "MoveEdge"},
        {**edit_record(edits[4]), "position": [1.0]},
        {**edit_record(edits[4]), "position": [1.0, True]},
    ):
        with pytest.raises((BadInput, TypeError, ValueError)):
            parse_edit(record)


def test_a_whole_plan_can_be_adopted_and_two_plans_compared() -> None:
    subject, system, plan = planned()
    editor = PlanEditor(subject, system, plan)
    even = plan_regions(subject.on_map, system, method="even")
    assert isinstance(even, CloudPlan)
    other = (even, split_edges(subject.on_map, even, system))
    editor.apply(AdoptPlan(name="even", cloud=other[0], edges=other[1]))
    assert same((editor.state.cloud, editor.state.edges), other)
    difference = plan_difference(plan, other)
    assert int(difference.new_edge.sum()) == (plan[0].edge_of_camera != even.edge_of_camera).sum() == sum(n for _, _, n in difference.flows)
    assert difference.makespan_after_s == even.makespan_s >= difference.makespan_before_s
    assert not plan_difference(plan, plan).new_device.any()
    assert plan_difference(plan, plan).text.startswith("No camera changes its edge; makespan")
    with pytest.raises(BadInput, match="compare plans of the same cameras"):
        plan_difference(plan, planned(num_cameras=50)[2])
    with pytest.raises(BadInput, match="120 cameras, there are 119"):
        PlanEditor(PlanSubject(names=subject.names[1:], positions=subject.positions[1:]), system, plan)
    with pytest.raises(BadInput, match="use the system it was planned for"):
        PlanEditor(subject, even_system(3, 2), plan)


def test_a_plan_that_is_cut_where_cameras_look_is_edited_by_that_and_saved_where_they_stand(tmp_path: Path) -> None:
    stood, system, (cloud, edges) = planned()
    # The same places are looked at from elsewhere.
    looks, stands = stood.on_map, stood.positions[::-1].copy()
    subject = PlanSubject(names=stood.names, positions=stands, looks=looks, origin=np.array([47.0, 8.0, 400.0]))
    editor, twin = PlanEditor(subject, system, (replace(cloud, looks=looks), edges)), PlanEditor(stood, system, (cloud, edges))
    camera = stood.names[int(np.flatnonzero(cloud.edge_of_camera == 0)[0])]
    for edit in (
        MoveEdge(edge=cloud.edge_ids[0], position=(120.0, 80.0)),
        PinCameras(cameras=(camera,), edge=cloud.edge_ids[1]),
        AddEdge(edge="new", position=(10.0, 10.0), like=cloud.edge_ids[1]),
        RemoveEdge(edge=cloud.edge_ids[2]),
    ):
        editor.apply(edit)
        twin.apply(edit)
        assert np.array_equal(editor.state.cloud.edge_of_camera, twin.state.cloud.edge_of_camera)
        np.testing.assert_array_equal(editor.state.cloud.places_of(stands[:, :2]), looks)
    setting = PlanSetting(
        system=system,
        reason="",
        edits_path=None,
        waypoints=None,
        ground_m=None,
        system_text=lambda system: "",
        constraints_text=lambda constraints, names, start: "",
    )
    save_edited_plan(tmp_path / "mine.json", subject, editor.state, setting)
    saved, waypoints = load_plan(tmp_path / "mine.json")[0], load_plan_waypoints(tmp_path / "mine.json")
    assert waypoints is not None
    # Latitude and longitude are rounded to micrometres on the way.
    apart = stands[:, :2] - waypoints.positions_m[:, :2]
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-2)
    np.testing.assert_allclose(saved.places_of(stands[:, :2]), looks - apart[0], atol=1e-2)
    again = load_other_plan(tmp_path / "mine.json", subject)
    np.testing.assert_allclose(again.cloud.places_of(stands[:, :2]), looks, atol=1e-6)
    with pytest.raises(BadInput, match="cut where cameras stand, this one where they look"):
        PlanEditor(subject, system, (replace(cloud, looks=looks), edges)).apply(AdoptPlan(name="other", cloud=cloud, edges=edges))
    with pytest.raises(BadInput, match="cut where cameras look, this one where they stand"):
        PlanEditor(stood, system, (replace(cloud, looks=looks), edges))


def test_a_plan_without_cameras_or_with_poisoned_positions_is_refused() -> None:
    with pytest.raises(BadInput, match="no cameras"):
        PlanSubject(names=(), positions=np.zeros((0, 3)))
    with pytest.raises(BadInput, match="not finite"):
        PlanSubject(names=("a",), positions=np.array([[np.nan, 0, 0]]))
    with pytest.raises(BadInput, match="comes twice"):
        PlanSubject(names=("a", "a"), positions=np.zeros((2, 3)))
