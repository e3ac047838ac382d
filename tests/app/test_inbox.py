"""What arrived: one bad sender is left out with its reason, whatever it sent, and costs no other; models move as their frames say."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_app.events import Decided, Event, StageProgress, Warned
from radiant_app.reporting import EventReporter
from radiant_app.workers.delivering import IDENTITY, exchange_keys
from radiant_app.workers.inbox import receive_device_models, receive_edge_models, save_joining
from radiant_core.aggregate.config import Join
from radiant_core.cameras import Cameras, concatenate_cameras, number_cameras
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.geometry.frame_refinement import PlacedModel, RefinedFrame
from radiant_core.hierarchy import joining
from radiant_core.hierarchy.codec import MAX_FRAME_BYTES, NOTHING, sim3_of, sim3_record
from radiant_core.hierarchy.joining import Arrivals, admit
from radiant_core.hierarchy.messages import EdgeTask
from radiant_core.io.records import save_cameras
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.upload import save_upload
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from tests.core.scenes import cameras_above, ground_splats

GROUND = ground_splats()
CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.5, 1.5)])
SURE = {"position_m": 1.0, "scale": 0.01, "rotation_rad": 0.02}
TURNED = Sim3(scale=2.0, rotation=np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), translation=np.array([5.0, -3, 1]))


def arrive(folder: Path, name: str, model: Splats = GROUND, cameras: Cameras | None = CAMERAS, uncertainty: Any = ...) -> None:
    """Lay an upload into the inbox, with what it says of its frame where something is given."""
    place = folder / "inbox" / name
    place.mkdir(parents=True)
    save_upload(place / "model.safetensors", model, "float32")
    if cameras is not None:
        save_cameras(place / "cameras.safetensors", cameras)
    if uncertainty is not ...:
        (place / "frame.json").write_text(json.dumps({"status": "placed", "reason": "", "uncertainty": uncertainty}))


def read_inbox(
    folder: Path, senders: list[str], stage: str, listen: Callable[[Event], None], dealt: dict[str, int] | None = None
) -> Arrivals:
    """What an edge joins of what arrived from these devices."""
    num_dealt = tuple((dealt or dict.fromkeys(senders, len(CAMERAS))).values())
    task = EdgeTask(
        train=train_preset("draft"),
        backend="native",
        devices=tuple(senders),
        num_dealt=num_dealt,
        strips=((),) * len(senders),
        join=Join(epochs=5),
    )
    return admit(receive_device_models(folder, task.devices), num_dealt, EventReporter(stage=stage, emit=listen))


def saved(folder: Path, inbox: Arrivals) -> list[str]:
    return save_joining(folder, inbox.corrections, inbox.refused, inbox.uncertainty)


def warnings(events: list[Event]) -> list[str]:
    return [event.message for event in events if isinstance(event, Warned)]


def test_what_is_sound_is_joined_in_the_senders_order_and_the_rest_named(tmp_path: Path) -> None:
    arrive(tmp_path, "a")
    arrive(tmp_path, "b", replace(GROUND, means=GROUND.means + np.float32(500)))
    arrive(tmp_path, "c", GROUND.select(np.arange(200)))
    arrive(tmp_path, "d")
    (tmp_path / "inbox/d/cameras.safetensors").write_bytes(b"no cameras")
    events: list[Event] = []
    inbox = read_inbox(tmp_path, ["a", "b", "c", "d"], "edges/north", events.append)
    assert inbox.senders == ("a", "c") and [len(model) for model in inbox.models] == [300, 200]
    assert all(len(cameras) == len(CAMERAS) for cameras in inbox.cameras)
    assert list(inbox.refused) == ["b", "d"] and inbox.refused["b"].startswith("its own cameras see 0.0%")
    assert warnings(events) == [f"the model of {name} is left out: {inbox.refused[name]}" for name in ("b", "d")]
    assert all(event.stage == "edges/north" for event in events if isinstance(event, Warned))
    # Where nobody says how unsure its frame is, nothing moves.
    assert inbox.uncertainty is None and [inbox.corrections[name] is None for name in "abcd"] == [False, True, False, True]
    for index, name in enumerate("ac"):
        assert (move := inbox.corrections[name]) is not None and (move.scale, move.translation.tolist()) == (1.0, [0, 0, 0])
        assert np.array_equal(inbox.cameras[index].cam_from_world, CAMERAS.cam_from_world)
    assert np.array_equal(inbox.models[0].means, GROUND.means)


def test_who_sends_more_cameras_than_it_was_dealt_is_refused_and_fewer_are_usual(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        arrive(tmp_path, name)
    inbox = read_inbox(tmp_path, ["a", "b", "c"], "edges/north", lambda event: None, dealt={"a": 6, "b": 5, "c": 9})
    assert inbox.senders == ("a", "c")
    assert inbox.refused == {"b": "it sends 6 cameras, where 5 photographs were dealt to it."}


def test_cameras_with_another_senders_names_cost_that_one_nothing(tmp_path: Path) -> None:
    for name in ("a", "b"):
        arrive(tmp_path, name, cameras=CAMERAS)
    cameras = read_inbox(tmp_path, ["a", "b"], "edges/north", lambda event: None).cameras
    assert len(concatenate_cameras(cameras)) == 2 * len(CAMERAS)


def test_an_empty_inbox_is_no_error(tmp_path: Path) -> None:
    inbox = read_inbox(tmp_path, ["a"], "edges/north", lambda event: None)
    assert inbox.models == () and inbox.senders == () and list(inbox.refused) == ["a"] and inbox.corrections == {"a": None}
    assert saved(tmp_path, inbox) == ["corrections.json", "refused.json", "frame.json"]
    assert read_json(tmp_path / "frame.json") == {"status": "missing", "reason": "", "uncertainty": None}
    # What a node that delivers nothing says of itself.
    assert NOTHING == {"num_splats": 0, "model_bytes": 0, "num_steps": 0, "train_s": 0.0, "first_loss": 0.0, "last_loss": 0.0}


def test_cameras_are_a_devices_an_edges_virtual_ones_or_none(tmp_path: Path) -> None:
    two = CAMERAS.select([0, 1])
    arrive(tmp_path, "device")
    arrive(tmp_path, "edge", cameras=None)
    arrive(tmp_path, "nothing", cameras=None)
    for name in ("device", "edge"):
        save_cameras(tmp_path / "inbox" / name / "virtual_cameras.safetensors", two)
    reporter = EventReporter(stage="cloud", emit=lambda event: None)
    at_cloud = admit(receive_edge_models(tmp_path, ["device", "edge", "nothing"]), [6, 6, 6], reporter)
    assert [len(cameras) for cameras in at_cloud.cameras] == [2, 2, 0], "the cloud does not look at poses of devices"
    at_edge = read_inbox(tmp_path, ["device", "nothing"], "edges/north", lambda event: None)
    assert [len(cameras) for cameras in at_edge.cameras] == [6, 0]


def test_only_signed_uploads_are_read_in_the_folder_of_a_run(tmp_path: Path) -> None:
    edge = tmp_path / "edges/north"
    exchange_keys(tmp_path, "edges/north", None)
    exchange_keys(tmp_path, "devices/a", "edges/north")
    arrive(edge, "a")
    signed = read_inbox(edge, ["a"], "edges/north", lambda event: None)
    assert signed.senders == () and "delivery.json" in signed.refused["a"]
    shutil.rmtree(edge / IDENTITY)
    assert read_inbox(edge, ["a"], "edges/north", lambda event: None).senders == ("a",), "a folder that was made by hand"


@pytest.mark.parametrize(
    "wrong",
    [
        {**SURE, "position_m": 0},
        {**SURE, "position_m": -1.0},
        {**SURE, "position_m": 2e6},
        {**SURE, "scale": "1"},
        {**SURE, "scale": True},
        {**SURE, "rotation_rad": 10**400},
        {"position_m": 1.0},
        {**SURE, "more": 1.0},
        [1.0, 1.0, 1.0],
        "x" * 5000,
    ],
)  # fmt: skip
def test_an_uncertainty_that_is_none_refuses_its_sender_alone(tmp_path: Path, wrong: Any) -> None:
    arrive(tmp_path, "a", uncertainty=SURE)
    arrive(tmp_path, "b", uncertainty=wrong)
    inbox = read_inbox(tmp_path, ["a", "b"], "edges/north", lambda event: None)
    assert inbox.senders == ("a",) and "frame.json" in inbox.refused["b"] and "\n" not in inbox.refused["b"]
    assert inbox.uncertainty is not None and asdict(inbox.uncertainty).keys() == SURE.keys()


def test_what_is_said_of_a_frame_ends_where_the_longest_reason_does(tmp_path: Path) -> None:
    for name, length in (("a", MAX_FRAME_BYTES), ("b", MAX_FRAME_BYTES + 1)):
        arrive(tmp_path, name, uncertainty={**SURE, "position_m": 1e6})
        path = tmp_path / "inbox" / name / "frame.json"
        path.write_text(path.read_text().ljust(length))
    inbox = read_inbox(tmp_path, ["a", "b"], "edges/north", lambda event: None)
    assert inbox.senders == ("a",) and f"expected at most {MAX_FRAME_BYTES}" in inbox.refused["b"]


def test_a_frame_to_be_refined_needs_cameras(tmp_path: Path) -> None:
    arrive(tmp_path, "a", uncertainty=SURE)
    arrive(tmp_path, "b", cameras=None, uncertainty=SURE)
    inbox = read_inbox(tmp_path, ["a", "b"], "edges/north", lambda event: None)
    assert inbox.senders == ("a",) and "no cameras" in inbox.refused["b"]


def test_exact_frames_beside_uncertain_ones_stay(tmp_path: Path) -> None:
    arrive(tmp_path, "a", uncertainty=SURE)
    arrive(tmp_path, "b", uncertainty=None)
    inbox = read_inbox(tmp_path, ["a", "b"], "edges/north", lambda event: None)
    assert inbox.uncertainty is None and inbox.senders == ("a", "b")
    assert all(move is not None and move.scale == 1 for move in inbox.corrections.values())


def refined(status: str, neighbours: tuple[int, ...], sure: float, move: Sim3 = TURNED, residual_m: float | None = 0.25) -> RefinedFrame:
    return RefinedFrame(
        status=status,
        correction=move,
        uncertainty=FrameUncertainty(position_m=sure, scale=sure / 10, rotation_rad=sure / 100),
        reason="" if status == "ok" else f"it is {status}.",
        residual_m=residual_m,
        neighbours=neighbours,
    )


def test_models_move_as_their_frames_were_refined_and_refused_ones_stay_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b", "c"):
        arrive(tmp_path, name, uncertainty={**SURE, "position_m": 7})
    asked: list[PlacedModel] = []
    answer = (refined("ok", (2,), 1.0), refined("refused", (), 0.5), refined("ok", (0,), 3.0))

    def refine_frames(models: list[PlacedModel], report: Any) -> tuple[RefinedFrame, ...]:
        asked.extend(models)
        report(1, 3, "a and b")
        return answer

    monkeypatch.setattr(joining, "refine_frames", refine_frames)
    events: list[Event] = []
    inbox = read_inbox(tmp_path, ["a", "b", "c"], "edges/north", events.append)
    assert [model.name for model in asked] == ["a", "b", "c"] and {model.uncertainty.position_m for model in asked} == {7.0}
    assert StageProgress(stage="edges/north", done=1, total=3, note="a and b") in events
    assert inbox.senders == ("a", "c") and inbox.refused == {"b": "it is refused."} and inbox.corrections["b"] is None
    assert warnings(events) == ["the model of b is left out: it is refused."]
    np.testing.assert_allclose(inbox.models[0].means, TURNED.apply(GROUND.means), atol=1e-5)  # float32 of some 10 m
    # A camera sees the moved world from where it saw the old one.
    np.testing.assert_allclose(inbox.cameras[1].centers, TURNED.apply(CAMERAS.centers), atol=1e-12)
    # Joined they are as sure as the surest of them: the refused one is surer, and is not there.
    assert inbox.uncertainty == FrameUncertainty(position_m=1.0, scale=0.1, rotation_rad=0.01)
    decisions = [event.decision for event in events if isinstance(event, Decided)]
    assert [(one.topic, one.choice, one.figure) for one in decisions] == [
        ("frame of a", "moved onto its neighbours", 0.25),
        ("frame of c", "moved onto its neighbours", 0.25),
    ]
    assert decisions[0].reason == "geometry shared with 1 neighbours; scale changed by 1000.0 mm per m"
    assert saved(tmp_path, inbox) == ["corrections.json", "refused.json", "frame.json"]
    moves = read_json(tmp_path / "corrections.json")
    assert moves["b"] is None and moves["a"] == sim3_record(TURNED) and read_json(tmp_path / "refused.json") == inbox.refused
    assert read_json(tmp_path / "frame.json") == {"status": "placed", "reason": "", "uncertainty": asdict(inbox.uncertainty)}


def test_models_beside_each_other_are_as_unsure_as_the_worst_and_one_alone_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        arrive(tmp_path, name, uncertainty=SURE)
    answer = (refined("ok", (), 1.0), refined("alone", (), 3.0, residual_m=None))
    monkeypatch.setattr(joining, "refine_frames", lambda models, report: answer)
    events: list[Event] = []
    inbox = read_inbox(tmp_path, ["a", "b"], "edges/north", events.append)
    assert inbox.senders == ("a", "b") and inbox.uncertainty is not None
    assert asdict(inbox.uncertainty) == pytest.approx({"position_m": 3.0, "scale": 0.3, "rotation_rad": 0.03})
    alone = [event.decision for event in events if isinstance(event, Decided)][1]
    assert (alone.choice, alone.figure, alone.reason) == ("stays where GPS puts it", None, "it is alone.")


def test_where_every_frame_is_refused_nothing_is_joined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arrive(tmp_path, "a", uncertainty=SURE)
    monkeypatch.setattr(joining, "refine_frames", lambda models, report: (refined("refused", (), 1.0),))
    inbox = read_inbox(tmp_path, ["a"], "edges/north", lambda event: None)
    assert inbox.models == () and inbox.uncertainty is None and inbox.refused == {"a": "it is refused."}


def test_a_model_that_contradicts_most_others_is_left_out_and_the_decision_says_how_far(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        arrive(tmp_path, name)
    arrive(tmp_path, "poisoned", replace(GROUND, sh0=-4 * GROUND.sh0 - 1))
    events: list[Event] = []
    names = ["a", "poisoned", "b", "c"]
    inbox = read_inbox(tmp_path, names, "edges/north", events.append)
    assert inbox.senders == ("a", "b", "c") and len(inbox.models) == len(inbox.cameras) == 3
    assert list(inbox.refused) == ["poisoned"] and inbox.corrections["poisoned"] is None and inbox.corrections["c"] is not None
    assert warnings(events) == [f"the model of poisoned is left out: {inbox.refused['poisoned']}"]
    (decision,) = (event.decision for event in events if isinstance(event, Decided))
    assert decision.topic == "models that contradict others" and decision.choice == "poisoned left out"
    assert decision.figure is not None and decision.figure < 10 and decision.stage == "edges/north"
    events.clear()
    assert read_inbox(tmp_path, ["a", "b", "c"], "edges/north", events.append).refused == {}
    (decision,) = (event.decision for event in events if isinstance(event, Decided))
    assert decision.choice == "all are joined" and decision.figure is not None and decision.figure > 50


def test_a_correction_comes_back_from_its_file(tmp_path: Path) -> None:
    write_json(tmp_path / "move.json", sim3_record(TURNED))
    back = sim3_of(read_json(tmp_path / "move.json"))
    assert back.scale == TURNED.scale
    assert np.array_equal(back.rotation, TURNED.rotation) and np.array_equal(back.translation, TURNED.translation)


def test_numbered_cameras_say_nothing_of_the_files(tmp_path: Path) -> None:
    assert number_cameras(CAMERAS.select([0, 1]), "north").names == ("north/0000", "north/0001")
