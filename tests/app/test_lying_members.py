"""What one member claims costs that member alone: each kind of claim is refused by name, and the run of the others goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Event, StageDone, StageStarted, Warned, decode, encode
from radiant_app.files.run_folder import Manifest
from radiant_app.files.system_file import load_system
from radiant_app.network import executor as network
from radiant_app.network.contents import check_result, check_scores, open_report, settle_notes
from radiant_app.network.device import HIDDEN_PLACE, hide_in_event, hide_places
from radiant_app.network.errands import Errands
from radiant_app.network.executor import MAX_SAYINGS, admit_event
from radiant_app.network.far_devices import FarDevices
from radiant_app.report import html
from radiant_app.reporting import read_notes
from radiant_app.run.captured import MOST_TIMES, place_rasters, weigh_claims
from radiant_app.run.choosing import keep_best
from radiant_app.workers.rasters import MAX_PHOTOGRAPHS, MOST_UNITS, raster_of, raster_problem
from radiant_app.workers.scores import Claimable, admit_scores, claim_problem, scores_of
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, StageFailed
from radiant_core.frames import enu_from_geodetic
from radiant_core.hierarchy.choosing import BEST_DB
from radiant_core.io.run_store import write_json
from radiant_core.plan.profiles.step_law import StepLaw
from radiant_core.plan.revision.assigned import assigned_plan
from radiant_viewer.runs.run_view import canonical_path, comparison_paths
from tests.stress.message_fuzz import FRAME, MOVE, NOTES, RASTER, REGION, ROW, SCORES, SUMMARY

DECISION = Decision(stage="devices/d", topic="t", choice="c", figure=1.0, unit="m", reason="r")
CLAIMABLE = Claimable(num_held_out=2, num_dealt=6, edges=("north", "south"))
LARGE = "9" * 3900


def changed(record: Any, path: str, value: Any) -> Any:
    """A deep copy of a record with another value at a dotted path."""
    copy = json.loads(json.dumps(record))
    *parents, last = (int(part) if part.isdigit() else part for part in path.split("."))
    place = copy
    for part in parents:
        place = place[part]
    place[last] = value
    return copy


def silent(heard: list[Event] | None = None) -> Any:
    return cast(Any, SimpleNamespace(listen=([] if heard is None else heard).append))


def warnings(heard: list[Event]) -> list[str]:
    return [event.message for event in heard if isinstance(event, Warned)]


# Events and notes

DECIDED = json.loads(encode(Decided(decision=DECISION)))


@pytest.mark.parametrize(
    "line",
    [
        *(
            json.dumps(changed(DECIDED, f"decision.{name}", value))
            for name, value in [
                ("stage", 5),
                ("topic", [1]),
                ("figure", "1"),
                ("figure", {}),
                ("reason", None),
                ("forced", 1),
                ("more", 1),
            ]
        ),
        "[" * 3900,
        '{"event":' * 3000,
        '{"event":"MemoryPeaked","stage":"devices/d","peak_bytes":' + LARGE + "}",
        '{"event":"StageDone","stage":"devices/d","seconds":-1e300}',
        '{"event":"StageDone","stage":"devices/d","seconds":1e300}',
        '{"event":"StageDone","stage":"devices/d","seconds":"1"}',
        '{"event":"StageProgress","stage":"devices/d","done":NaN,"total":1}',
        '{"event":"StageProgress","stage":"devices/d","done":1,"total":2,"step":-1}',
        '{"event":"Warned","stage":"devices/d","message":"\\ud800"}',
        '{"event":"Warned","stage":["devices/d"],"message":""}',
        '{"event":"Outlined","stages":5}',
    ],
)
def test_a_line_that_is_typed_otherwise_is_no_event_and_ends_nothing(line: str) -> None:
    with pytest.raises(StageFailed, match="a line that is no event"):
        decode(line)
    assert admit_event(line, "devices/d", set()) == []


def test_half_a_character_of_a_file_name_ends_no_run() -> None:
    assert decode(encode(Warned(stage="sfm", message="a\udcff.jpg 😀"))) == Warned(stage="sfm", message="a?.jpg 😀")


@pytest.mark.parametrize(
    "stage", ["edges/north", "devices/e", "devices/d/../../x", "devices/d/a/b", "devices/dd", "cloud", "devices/d\x1b"]
)
def test_a_device_speaks_of_its_own_stages_alone(stage: str) -> None:
    assert admit_event(encode(Warned(stage=stage, message="m")), "devices/d", set()) == []


def test_an_edge_speaks_of_its_own_devices_alone() -> None:
    said = {name: encode(Warned(stage=f"devices/{name}/score", message="m")) for name in ("d", "e")}
    assert len(admit_event(said["d"], "edges/north", set(), ("d",))) == 1
    assert admit_event(said["e"], "edges/north", set(), ("d",)) == []


def test_a_time_that_is_said_to_be_emulated_ends_no_run(tmp_path: Path) -> None:
    """At 9138611c: KeyError in the manifest of whoever conducts."""
    manifest, begun = Manifest(folder=tmp_path, config={}), set[str]()
    for event in (StageStarted(stage="devices/d"), StageDone(stage="devices/d", seconds=1.0, emulated=True)):
        for heard in admit_event(encode(event), "devices/d", begun):
            manifest.record(heard, 1.0)
    assert [*manifest.stages] == ["devices/d"] and manifest.emulated == {}


def test_what_one_task_warns_of_is_bounded() -> None:
    machines = network._Machines(executor=cast(Any, SimpleNamespace(devices_of=lambda machine: ())), local=cast(Any, None))
    task = cast(Any, SimpleNamespace(stage="devices/d"))
    far = network._Far(task=task, digest="", node="devices/d", heard=0, alive_s=0.0)
    events: list[Event] = []
    for start in range(0, 3 * MAX_SAYINGS, 500):
        lines = tuple(encode(Warned(stage="devices/d", message=str(number))) for number in range(start, start + 500))
        events += machines._heard(far, lines)
    assert len(events) == MAX_SAYINGS + 1
    assert warnings(events)[-1] == "devices/d warns of and decides more than 1,000 things: the rest is left out."


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("decisions.0.stage", 5),
        ("decisions.0.topic", [1]),
        ("decisions.0.figure", "1"),
        ("warnings", [5, {}]),
        ("warnings", "w"),
        ("more", 1),
    ],
)
def test_notes_of_another_type_are_refused(path: str, value: Any, tmp_path: Path) -> None:
    write_json(tmp_path / "notes.json", changed(NOTES, path, value))
    with pytest.raises(BadInput, match=r"notes.json cannot be used"):
        read_notes(tmp_path, "devices/d")


def test_notes_of_a_stranger_are_kept_as_those_of_its_own_stage_in_plain_text(tmp_path: Path) -> None:
    record = changed(changed(NOTES, "decisions.0.reason", "a\x1b[2J"), "warnings.0", "b\nc")
    write_json(tmp_path / "notes.json", record)
    settle_notes(tmp_path, "devices/d")
    decided, warned = read_notes(tmp_path, "devices/d")
    assert isinstance(decided, Decided) and (decided.decision.stage, decided.decision.reason) == ("devices/d", "a [2J")
    assert warned == Warned(stage="devices/d", message="b c")
    write_json(tmp_path / "notes.json", {"decisions": [], "warnings": ["w"] * 1001})
    with pytest.raises(BadInput, match="1,001 decisions and warnings, expected at most 1,000"):
        settle_notes(tmp_path, "devices/d")


# Scores

SCORES_OF_NO_DEVICE: Mapping[str, Any] = {
    "an extra key of a border": ("borders.0.extra", 1),
    "an extra key of a row": ("images.0.extra", 1),
    "an extra key": ("more", 1),
    "a psnr of null": ("images.0.psnr_db", None),
    "a psnr as text": ("images.0.psnr_db", "24"),
    "a psnr beyond equal images": ("images.0.psnr_db", 100.5),
    "a negative psnr": ("images.0.psnr_db", -1.0),
    "an ssim of 2": ("images.0.ssim", 2.0),
    "a flip of 2": ("images.0.flip", 2.0),
    "a huge figure": ("images.0.lpips", 1.7e308),
    "a figure of 3,900 digits": ("images.0.psnr_db", int(LARGE)),
    "a border as text": ("borders.0.before_db", "1"),
    "a border of 1.7e308": ("borders.0.before_db", 1.7e308),
    "a border beyond any error": ("borders.0.beyond_db", -61.0),
    "an absolute name": ("images.0.name", "/etc/secret"),
    "a name above": ("images.0.name", "d/../../secret"),
    "a name with NUL": ("images.0.name", "d/\0"),
    "a name twice": ("images.1.name", "d/held-out-0000"),
    "a name of half a character": ("images.0.name", "d/\udcff"),
    "versions of fewer photographs": ("versions.cut", [1.0]),
    "a version that is none": ("versions.best", [1.0, 2.0]),
    "a version as text": ("versions.cut", ["1", "2"]),
    "a leakage of others": ("leakage.more", 1),
    "a leakage of no photograph": ("leakage.num_images", 0),
}


@pytest.mark.parametrize("name", SCORES_OF_NO_DEVICE)
def test_scores_of_another_type_or_range_are_refused(name: str) -> None:
    scores_of(SCORES)
    with pytest.raises(BadInput, match="scores cannot be used: "):
        check_scores(changed(SCORES, *SCORES_OF_NO_DEVICE[name]))


def rows(number: int, device: str = "d", db: float = 99.0) -> dict[str, Any]:
    images = [{**ROW, "name": f"{device}/held-out-{index:04d}", "psnr_db": db} for index in range(number)]
    return {**SCORES, "images": images, "versions": {"joined": [db] * number, "cut": [0.0] * number}}


CLAIMS: Mapping[str, tuple[Any, str]] = {
    "more photographs than it holds out": (rows(1000), r"it scores 1,000 photographs and holds out 2 by the plan\."),
    "those of another device": (rows(2, "honest"), "it scores 'honest/held-out-0000', expected its photographs by numbers"),
    "a name of its own": (changed(SCORES, "images.1.name", "d/held-out-0007"), "it scores 'd/held-out-0007'"),
    "a border that is none": (changed(SCORES, "borders.0.beyond", "east"), "a border of 'north' and 'east', which the plan does not have"),
    "a border with itself": (changed(SCORES, "borders.0.beyond", "north"), "a border of 'north' and 'north'"),
    "borders of more photographs": (changed(SCORES, "borders", SCORES["borders"] * 3), r"one border in 9 photographs and trains on 6"),
    "a leakage of more photographs": (changed(SCORES, "leakage.num_images", 7), "compares 7 synthetic views and trains on 6 photographs"),
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_claim_against_the_plan_is_refused_by_name_and_the_others_count(claim: str, tmp_path: Path) -> None:
    record, reason = CLAIMS[claim]
    said: list[tuple[str, str]] = []
    honest = {**rows(2, "honest", 20.0), "leakage": None}
    admitted = admit_scores(
        {"d": scores_of(record), "honest": scores_of(honest)}, lambda device: CLAIMABLE, lambda *each: said.append(each)
    )
    assert [*admitted] == ["honest"] and claim_problem(scores_of(SCORES), "d", CLAIMABLE) is None
    ((device, message),) = said
    assert device == "d" and message.startswith("the figures of this device are left out: ")
    with pytest.raises(BadInput, match=reason):
        raise BadInput(message)


def test_no_photograph_of_a_device_weighs_more_than_any_of_8_bits() -> None:
    said: list[tuple[str, str]] = []
    admitted = admit_scores({"d": scores_of(rows(2))}, lambda device: CLAIMABLE, lambda *each: said.append(each))
    assert [row["psnr_db"] for row in admitted["d"].rows] == [BEST_DB] * 2
    assert said == [("d", "2 of its photographs have more than 60 dB, which no photograph of 8 bits shows: 60 dB count.")]


def test_files_of_scores_that_are_none_are_left_out(tmp_path: Path) -> None:
    for name, (path, value) in {"one": ("borders.0.extra", 1), "two": ("images.0.psnr_db", None)}.items():
        write_json(tmp_path / f"{name}.json", changed(SCORES, path, value))
    write_json(tmp_path / "d.json", SCORES)
    said: list[tuple[str, str]] = []
    files = {name: tmp_path / f"{name}.json" for name in ("one", "d", "two")}
    admitted = admit_scores(files, lambda device: CLAIMABLE, lambda *each: said.append(each))
    assert [*admitted] == ["d"] and [device for device, _ in said] == ["one", "two"]


@pytest.mark.parametrize("text", ["[" * 3000, "{}", '{"versions": {"joined": "20", "cut": [1]}}', '{"versions": 5}', ""])
def test_a_file_that_compares_nothing_ends_no_choice(text: str, tmp_path: Path) -> None:
    (tmp_path / "d.json").write_text(text)
    (tmp_path / "honest.json").write_text('{"versions": {"joined": [20.0], "cut": [20.0]}}')
    heard: list[Event] = []
    dealer = SimpleNamespace(versions={"joined": tmp_path, "cut": tmp_path}, version="joined", chosen=None)
    scores, facts = keep_best(cast(Any, dealer), lambda _: {name: tmp_path / f"{name}.json" for name in ("d", "honest")}, heard.append)
    assert [*scores] == ["honest"] and facts["versions"] == {"joined": 20.0, "cut": 20.0}
    assert warnings(heard)[0].startswith("d does not compare the versions")


# Names that are joined to a path


@pytest.mark.parametrize("climb", [False, True])
def test_a_name_of_a_score_shows_no_picture_of_the_owner(climb: bool, tmp_path: Path) -> None:
    run = tmp_path / "run"
    for kind in ("photographs", "renders", "differences", "canonical"):
        (run / "pictures" / kind).mkdir(parents=True)
    (run / "manifest.json").write_text("{}")
    for place in (tmp_path / "secret.png", run / "pictures" / "photographs" / "d.png"):
        cv2.imwrite(str(place), np.zeros((4, 4, 3), np.uint8))
    name = "../../../secret" if climb else str(tmp_path / "secret")
    assert not html._has_pictures(run, {"name": name}) and html._has_pictures(run, {"name": "d"})
    view = cast(Any, SimpleNamespace(folder=run, in_field=True))
    with pytest.raises(BadInput, match="no name of a photograph inside a run"):
        comparison_paths(view, name)
    assert canonical_path(view, name) is None


# Counts and rasters

WRONG_RASTERS: Mapping[str, Any] = {
    "a latitude of 1e5": ("cells.0.0", 1e5),
    "a longitude of 181": ("cells.0.1", 181.0),
    "an altitude of 1e300": ("altitude_m", 1e300),
    "an altitude below any sea": ("altitude_m", -12_000.0),
    "places and no altitude": ("altitude_m", None),
    "a cell of 10^8": ("cells.0.2", 10**8),
    "a cell of none": ("cells.0.2", 0),
    "more in cells than there are": ("num_photographs", 4),
    "a count as text": ("num_photographs", "6"),
    "a count of 3,900 digits": ("num_photographs", int(LARGE)),
    "a count too large": ("num_photographs", MAX_PHOTOGRAPHS + 1),
    "a negative count": ("num_unplaced", -1),
    "another field": ("more", 1),
}


@pytest.mark.parametrize("name", WRONG_RASTERS)
def test_a_raster_of_no_device_is_refused(name: str, tmp_path: Path) -> None:
    raster_of(RASTER, "gps")
    record = changed(RASTER, *WRONG_RASTERS[name])
    with pytest.raises(BadInput, match=r"^a raster "):
        raster_of(record, "gps")
    write_json(tmp_path / "report.json", {"found": {"d": record, "honest": RASTER}, "missing": {}})
    check_result("edge_raster", tmp_path, ["report.json"])
    report = open_report("edge_raster", tmp_path, "gps")
    assert [*report.records] == ["honest"] and report.missing["d"].startswith("a raster "), "the others of its edge count"


def test_a_raster_is_of_the_photographs_that_were_counted() -> None:
    raster = raster_of(RASTER)
    assert raster_problem(raster, 6, 5) is None
    assert raster_problem(raster, 5, 5) == "its raster has 6 photographs, and it counted 5 before."
    assert raster_problem(raster, 6, 4) == "its raster places 5 photographs, and it trains on 4 of those that it counted."
    heard: list[Event] = []
    devices = FarDevices(config=RunConfig(source=Path("s"), out=Path("o")), edges=cast(Any, None), counts={"d": 3, "e": 6})
    usable = devices._usable_rasters({"d": raster, "e": raster}, silent(heard))
    assert [*usable] == ["e"] and warnings(heard) == ["device d takes no part: its raster has 6 photographs, and it counted 3 before."]


def places(latitude: float, longitude: float, number: int, altitude_m: float = 500.0) -> Any:
    return raster_of({**RASTER, "cells": [[latitude, longitude, number]], "altitude_m": altitude_m, "num_photographs": number}).middles


@pytest.mark.parametrize("claimed", [1, 100, MAX_PHOTOGRAPHS])
def test_the_site_is_where_most_devices_are_whatever_one_claims(claimed: int) -> None:
    heard: list[Event] = []
    devices = {"a": places(48.1, 11.5, 6), "b": places(48.101, 11.5, 3), "liar": places(10.0, 10.0, claimed)}
    origin, own = place_rasters(devices, silent(heard))
    assert np.abs(origin - [48.1, 11.5, 500]).max() < 0.01
    assert {name: len(rows) for name, rows in own.items()} == {"a": 6, "b": 3, "liar": 0}
    (warning,) = warnings(heard)
    assert "those of liar first" in warning and "are left out" in warning
    honest, _ = place_rasters({name: devices[name] for name in ("a", "b")}, silent())
    assert (origin == honest).all()


def test_of_two_devices_apart_one_site_is_taken_and_a_warning_says_so() -> None:
    heard: list[Event] = []
    _, own = place_rasters({"a": places(48.1, 11.5, 2), "b": places(10.0, 10.0, 100)}, silent(heard))
    assert {name: len(rows) for name, rows in own.items()} == {"a": 2, "b": 0}
    assert warnings(heard)[0].startswith("1 of 2 devices are at the site of a and as many at that of b, too far apart for one run")


def test_a_site_across_the_180th_meridian_is_one() -> None:
    _, own = place_rasters({"a": places(-17.0, 179.999, 2), "b": places(-17.0, -179.999, 3)}, silent())
    assert {name: len(rows) for name, rows in own.items()} == {"a": 2, "b": 3}
    away_m = enu_from_geodetic(np.array([[-17.0, -179.999, 500.0]]), np.array([-17.0, 179.999, 500.0]))
    assert np.linalg.norm(own["b"][0] - own["a"][0]) == pytest.approx(np.linalg.norm(away_m[0, :2]), abs=0.1)


@pytest.mark.parametrize("claimed", [60, 600, 60_000])
def test_no_claim_takes_the_training_of_the_others(claimed: int) -> None:
    """At 9138611c a device with 6 photographs trained 182 or 100 of its 1,000 steps beside one that claimed 60 or 600."""
    heard: list[Event] = []
    owners = ["honest"] * 6 + ["liar"] * claimed
    weighed = weigh_claims(owners, silent(heard))
    counts = {name: sum(owners[row] == name for row in weighed) for name in ("honest", "liar")}
    assert counts == {"honest": 6, "liar": 6 * MOST_TIMES}
    law = StepLaw(num_steps=1000, mean_photographs=len(weighed) / 2)
    assert law.steps(6) == round(1000 * 2 / (1 + MOST_TIMES))
    assert warnings(heard) == [
        f"device liar has {claimed:,} photographs, more than 4 times as many as most devices: steps are shared as if there were 24."
    ]


def test_devices_of_like_sizes_are_all_counted() -> None:
    heard: list[Event] = []
    owners = ["a"] * 10 + ["b"] * 40 + ["c"] * 20
    assert (weigh_claims(owners, silent(heard)) == np.arange(70)).all() and heard == []


# What an edge says of its join

REGIONS: Mapping[str, tuple[str, str, Any]] = {
    "a scale as text": ("corrections.json", "d.scale", "2"),
    "a scale of 0": ("corrections.json", "d.scale", 0.0),
    "a rotation that mirrors": ("corrections.json", "d.rotation", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
    "a device of another edge": ("corrections.json", "other", MOVE),
    "a model of no device": ("corrections.json", "d", None),
    "a refusal of another's device": ("refused.json", "other", "why"),
    "a reason that is no text": ("refused.json", "e", 5),
    "no bytes of a model": ("summary.json", "model_bytes", None),
    "negative seconds": ("summary.json", "train_s", -1.0),
    "a figure of 3,900 digits": ("summary.json", "num_steps", int(LARGE)),
    "another figure as text": ("summary.json", "num_models", "2"),
    "an uncertainty that is none": ("frame.json", "uncertainty.scale", "1"),
    "another state": ("frame.json", "status", "maybe"),
}


@pytest.mark.parametrize("name", REGIONS)
def test_a_join_that_says_else_is_refused(name: str, tmp_path: Path) -> None:
    for file, record in REGION.items():
        (tmp_path / file).write_bytes(record if isinstance(record, bytes) else json.dumps(record).encode())
    check_result("region", tmp_path, [*REGION])
    file, path, value = REGIONS[name]
    (tmp_path / file).write_text(json.dumps(changed(REGION[file], path, value)))
    with pytest.raises(BadInput):
        check_result("region", tmp_path, [*REGION])


def test_one_wrong_device_of_a_report_is_missing_with_a_plain_reason(tmp_path: Path) -> None:
    told = {"frame": FRAME, "summary": SUMMARY}
    found = {"d": told, "e": changed(told, "summary.train_s", "1"), "f": changed(told, "frame.reason", "a\x1bb")}
    write_json(tmp_path / "report.json", {"found": found, "missing": {"g": "c\x1b[2J"}})
    report = open_report("region", tmp_path)
    assert [*report.records] == ["d", "f"] and report.records["f"].frame.reason == "a b"
    assert report.missing["g"] == "c [2J" and "summary.train_s is '1'" in report.missing["e"]


def test_a_key_that_is_printed_moves_no_cursor() -> None:
    with pytest.raises(BadInput) as refused:
        scores_of({**SCORES, "a\x1b[2J": 1})
    assert str(refused.value).isprintable()


# What the node above answers


class Answering:
    """A way on which one answer comes."""

    def __init__(self, answer: dict[str, Any]) -> None:
        self.answer, self.counter = answer, 1
        self.upper = SimpleNamespace(upper="edges/north")

    def poll(self, body: Mapping[str, Any]) -> dict[str, Any]:
        return self.answer


@pytest.mark.parametrize(
    "answer",
    [
        {"wait_s": int(LARGE)},
        {"wait_s": "1"},
        {"wait_s": -1},
        {"verdict": {"state": 5}},
        {"task": {"text": 5, "signature": ""}},
        {"task": {"text": "", "signature": "", "tries": 1.5}},
        {"more": 1},
    ],
)
def test_an_answer_of_another_type_is_refused_in_one_sentence(answer: dict[str, Any]) -> None:
    errands = Errands(home=cast(Any, None), line=cast(Any, Answering(answer)), performer=cast(Any, None))
    with pytest.raises(BadInput, match=r"what edges/north answers cannot be used: .*: use the same version"):
        errands._round()


# Folders of a device's owner

NODE = "devices/north"


@pytest.mark.parametrize("folder", ["/north", "/devices", "/score", "/s", "/north/score", "/"])
def test_the_stage_of_an_event_stays_whatever_its_owner_calls_folders(folder: str) -> None:
    event = hide_in_event(Warned(stage=f"{NODE}/score", message=f"{folder}/a.jpg is damaged"), [Path(folder)])
    assert isinstance(event, Warned) and event.stage == f"{NODE}/score" and event.message.startswith(HIDDEN_PLACE)
    decided = hide_in_event(Decided(decision=replace(DECISION, stage=NODE, reason=f"of {folder}")), [Path(folder)])
    assert isinstance(decided, Decided) and decided.decision.stage == NODE and decided.decision.reason == f"of {HIDDEN_PLACE}"


@pytest.mark.parametrize(
    ("text", "hidden"),
    [
        ("devices/north: /north/a.jpg", f"devices/north: {HIDDEN_PLACE}/a.jpg"),
        ("'/north'", f"'{HIDDEN_PLACE}'"),
        ("file:///north", f"file://{HIDDEN_PLACE}"),
        ("a=/north:/north", f"a={HIDDEN_PLACE}:{HIDDEN_PLACE}"),
        ('{"message": "a\\n/north"}', f'{{"message": "a\\n{HIDDEN_PLACE}"}}'),
        ("b'\\xc3/north'", f"b'\\xc3{HIDDEN_PLACE}'"),
        ("north-1/north", "north-1/north"),
    ],
)
def test_a_folder_below_the_root_is_hidden_where_it_is_a_folder(text: str, hidden: str) -> None:
    assert hide_places(text, [Path("/north")]) == hidden


@pytest.mark.parametrize("far", [MOST_UNITS, -MOST_UNITS, 1e6])
def test_a_device_that_is_far_away_in_the_frame_of_poses_ends_no_plan(far: float, tmp_path: Path) -> None:
    """With given poses there is no globe: what a raster may say a plan can be made of."""
    system = tmp_path / "system.toml"
    system.write_text('[[edge]]\nid = "north"\n[[edge.device]]\nid = "a"\n[[edge.device]]\nid = "liar"\n')
    rasters = {"a": [[0.5, 0.5, 3], [1.5, 0.5, 3]], "liar": [[far, far, 3]]}
    places = {name: raster_of({**RASTER, "cells": cells, "altitude_m": None}, "known").middles for name, cells in rasters.items()}
    owners = [name for name, own in places.items() for _ in own]
    _, (edge,) = assigned_plan(np.concatenate([*places.values()])[:, :2], owners, load_system(system))
    assert [len(edge.cameras_of(name)) for name in ("a", "liar")] == [6, 3]
    with pytest.raises(BadInput, match="a raster cannot be used: cells"):
        raster_of({**RASTER, "cells": [[1e8, 0.0, 1]], "altitude_m": None}, "known")
