"""Mutated messages of the network: seeded, so that a finding can be found again by its kind and number.

    report = fuzz_messages("scores", count, seed, folder)    every mutated message goes where its receiver uses it
    report.surprises                                         [] where each was used or refused with a reason

Half of them are changed in their bytes, half in one value of their JSON. By hand:
`python -m tests.stress.message_fuzz scores 20000`; without a kind all of them.
"""

from __future__ import annotations

import base64
import json
import random
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast, get_args

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from radiant_app.events import (
    CpuSpent,
    Decided,
    Event,
    Failed,
    Foreseen,
    Heartbeat,
    MemoryPeaked,
    Outlined,
    RunLeft,
    StageDone,
    StageProgress,
    StageSkipped,
    StageStarted,
    TimeLeft,
    Warned,
    encode,
)
from radiant_app.files.run_folder import Manifest
from radiant_app.network.contents import check_result, open_report, settle_notes
from radiant_app.network.errands import PollAnswer
from radiant_app.network.executor import admit_event
from radiant_app.network.home import accept_invitation, invitation_text, make_home, new_invitation
from radiant_app.network.messages import EDGE_TASKS, EdgeCountTask, EdgeRasterTask, EdgeRefineTask, EdgeScoreTask
from radiant_app.network.packs import LIST_NAME, SIGNATURE_NAME, open_pack, read_join, write_join
from radiant_app.reporting import read_notes
from radiant_app.run.captured import place_rasters
from radiant_app.run.scoring import combine_figures
from radiant_app.strangers import parse_record
from radiant_app.workers.inbox import load_corrections
from radiant_app.workers.scores import Claimable, admit_scores
from radiant_app.workers.tasks import TASKS, CountTask, Move, OwnFieldTask, RasterTask, ScoreTask, SfmSettings
from radiant_core.aggregate.averaging import Refinement
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.hierarchy.codec import NOTHING, load_device_model, load_refinement, load_task, save_refinement, save_task, sim3_record
from radiant_core.io.records import save_cameras
from radiant_core.io.run_store import parse_json, write_json
from radiant_core.io.transport.delivery import SentFile, describe_files
from radiant_core.io.transport.envelope import Envelope, envelope_bytes, open_envelope
from radiant_core.io.transport.upload import save_upload
from radiant_core.train.config import train_preset
from tests.app.network_nodes import listening
from tests.app.test_network_reception import World, poll_body
from tests.core.scenes import cameras_above, ground_splats
from tests.memory_folder import memory_folder
from tests.stress.reader_fuzz import mutated

SEED = 58
SHOWN = 5
RUN = "0" * 32
ODD: tuple[Any, ...] = (
    None, True, "", "1", "x" * 5000, "\ud800", "\x1b[2J\n", "/etc/hostname", "../../x", -1, 0, 1, 10**8, 10**3900, -(10**3900), 2**63,
    -1e300, 1e300, 1.7e308, 5e-324, 0.5, 1e5, [], [1], {}, {"a": 1}, [[]] * 50, "devices/south", "edges/north", "device",
)  # fmt: skip
Receive = Callable[[bytes], object]


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of message: whole ones to start from, and what its receiver does with one."""

    seeds: list[bytes]
    receive: Receive


@dataclass(frozen=True, kw_only=True)
class MessageReport:
    """What came of so many mutated messages."""

    count: int
    num_refused: int
    surprises: list[str]
    longest_s: float
    """CPU seconds of one message."""
    seconds: float


def mutated_value(data: bytes, rng: random.Random) -> bytes:
    """The JSON of a message in which one value, at any depth, is another, gone, or has a neighbour."""
    record = json.loads(data)
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
            places.append((value, key))
            walk(inner)

    walk(record)
    if not places or rng.randrange(40) == 0:
        return b"[" * rng.choice((1, 3900)) + json.dumps(rng.choice(ODD)).encode()
    for _ in range(rng.choice((1, 1, 2))):
        parent, key = rng.choice(places)
        value: Any = parent[key] if not isinstance(parent, dict) or key in parent else None
        change = rng.randrange(10)
        if change > 6 and type(value) in (int, float) and abs(value) < 1e300:
            # What is still a number, and might be believed.
            scaled = value * rng.choice((-1, 0, 0.5, 1.001, 2, 4, 100))
            parent[key] = int(scaled) if isinstance(value, int) else scaled
        elif change == 0 and isinstance(parent, dict):
            parent.pop(key, None)
        elif change == 1:
            parent[f"{key}2" if isinstance(parent, dict) else 0] = rng.choice(ODD)
        else:
            parent[key] = rng.choice(ODD)
    return json.dumps(record).encode()


def fuzz_messages(name: str, count: int, seed: int, folder: Path, first: int = 0) -> MessageReport:
    """Receive `count` mutated messages of a kind, one after the other; `first` skips to a number that was reported."""
    kind = KINDS[name](folder)
    assert any(kind.receive(data) is not REFUSED for data in kind.seeds), "a whole message is taken"
    surprises: list[str] = []
    num_surprises = num_refused = 0
    longest_s, begun_s = 0.0, time.monotonic()
    for number in range(first, first + count):
        rng = random.Random(seed * 1_000_003 + number)
        data = rng.choice(kind.seeds)
        is_json = data[:1] in b"{["
        data = mutated_value(data, rng) if is_json and rng.randrange(2) else mutated(data, rng)
        begun = time.process_time()
        try:
            num_refused += kind.receive(data) is REFUSED
        except BadInput as error:
            num_refused += 1
            if not str(error):
                num_surprises, surprises = num_surprises + 1, [*surprises, f"{name} {number}: refused without a word"][:SHOWN]
        except Exception as error:  # noqa: BLE001 whatever else comes is what is looked for
            num_surprises, surprises = num_surprises + 1, [*surprises, f"{name} {number}: {type(error).__name__}: {error}"[:300]][:SHOWN]
        longest_s = max(longest_s, time.process_time() - begun)
    if num_surprises > SHOWN:
        surprises.append(f"… {num_surprises} in all")
    seconds = time.monotonic() - begun_s
    return MessageReport(count=count, num_refused=num_refused, surprises=surprises, longest_s=longest_s, seconds=seconds)


REFUSED = object()
"""What a receiver returns that refuses without an error."""


@dataclass(kw_only=True)
class _Unsaved(Manifest):
    """A manifest that would be written: as JSON, to nowhere."""

    def save(self) -> None:
        json.dumps([self.stages, self.emulated, self.peak_bytes, self.decisions, self.warnings], allow_nan=False).encode()


def _events(_: Path) -> Kind:
    decided = Decision(stage="devices/d", topic="t", choice="c", figure=1.5, unit="m", reason="r")
    told: list[Event] = [
        Decided(decision=decided),
        Warned(stage="devices/d/count", message="m"),
        StageProgress(stage="devices/d", done=1, total=2, phase="p", step=1, num_steps=2, left_s=3.0),
        StageStarted(stage="devices/d", machine="x"),
        StageDone(stage="devices/d", seconds=1.5, emulated=True),
        MemoryPeaked(stage="devices/d", peak_bytes=10),
        CpuSpent(stage="devices/d", seconds=2.5),
        StageSkipped(stage="devices/d"),
        Failed(stage="devices/d", message="m", exit_code=2),
        Heartbeat(stage="devices/d"),
        Outlined(stages=("devices/d",)),
        TimeLeft(seconds=1.0, correction=1.0, after="devices/d"),
        Foreseen(phases_s=(1.0, 2.0), units=(0, 1)),
        RunLeft(phase="training", number=2, num_phases=6, elapsed_s=3.0, left_s=4.0, off_percent=45.0),
    ]
    assert {type(each) for each in told} == {*get_args(Event)}
    begun: set[str] = set()
    manifest = _Unsaved(folder=Path("unused"), config={})

    def receive(data: bytes) -> object:
        if len(manifest.decisions) + len(manifest.warnings) > 200:
            manifest.decisions.clear()
            manifest.warnings.clear()
        line = data.decode(errors="replace")
        heard = [event for node in ("devices/d", "edges/north") for event in admit_event(line, node, begun, ("d",))]
        for event in heard:
            manifest.record(event, 1.0)
            encode(event)
        return None if heard else REFUSED

    return Kind(seeds=[encode(event).encode() for event in told], receive=receive)


def _in_folder(folder: Path, files: dict[str, Any], name: str, use: Callable[[Path], object]) -> Kind:
    """The message that stands in one of these files, the others being whole."""
    for other, content in files.items():
        (folder / other).write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    whole = (folder / name).read_bytes()

    def receive(data: bytes) -> object:
        (folder / name).write_bytes(data)
        return use(folder)

    return Kind(seeds=[whole], receive=receive)


def _of_result(kind: str, files: dict[str, Any], name: str, use: Callable[[Path], object] = lambda folder: None) -> Callable[[Path], Kind]:
    """A file of a result of this kind; `use` is what the conductor does with it then."""

    def receive(folder: Path) -> object:
        check_result(kind, folder, [*files])
        return use(folder)

    return lambda folder: _in_folder(folder, files, name, receive)


def _silent() -> Any:
    return cast(Any, SimpleNamespace(listen=encode))


FRAME = {"status": "placed", "reason": "", "uncertainty": {"position_m": 1.0, "scale": 0.01, "rotation_rad": 0.02}}
SUMMARY = {**NOTHING, "num_splats": 5, "num_models": 2}
MOVE = sim3_record(Sim3(scale=2.0, rotation=np.eye(3), translation=np.array([1.0, 2.0, 3.0])))
RASTER = {"cells": [[48.1, 11.5, 3], [48.2, 11.5, 2]], "altitude_m": 520.0, "num_photographs": 6, "num_unplaced": 0}
NOTES = {"decisions": [asdict(Decision(stage="s", topic="t", choice="c", figure=None, unit="", reason="r"))], "warnings": ["w"]}
ROW = {"name": "d/held-out-0000", "psnr_db": 24.0, "ssim": 0.8, "psnr_cc_db": 25.0, "ssim_cc": 0.8, "flip": None, "lpips": 0.2}
SCORES = {
    "images": [{**ROW, "initial_psnr_db": 10.0, "mean_color_psnr_db": 9.0, "used_share": 0.5}, {**ROW, "name": "d/held-out-0001"}],
    "borders": [{"side": a, "beyond": b, "before_db": -20.0, "beyond_db": -18.0} for a, b in (("north", "south"), ("south", "north")) * 3],
    "leakage": {"psnr_db": 25.0, "ssim": 0.8, "num_images": 6},
    "versions": {"joined": [24.0, 25.0], "cut": [23.0, 24.0]},
}
PLACED = {"task.json": {"devices": ["d", "e"], "frames": "gps"}, "model.safetensors": b"", "delivery.json": b"", "delivery.sig": b""}
FIELD = {**PLACED, "cameras.safetensors": b"", "frame.json": FRAME, "summary.json": SUMMARY}
TASK_KINDS = ("count", "raster", "own_field", "score", "edge_count", "edge_raster", "edge_refine", "edge_score")
REGION = {
    **PLACED,
    "frame.json": FRAME,
    "summary.json": SUMMARY,
    "notes.json": NOTES,
    "corrections.json": {"d": MOVE, "e": None},
    "refused.json": {"e": "it is far away."},
    "report.json": {"found": {"d": {"frame": FRAME, "summary": SUMMARY}}, "missing": {"e": "it is late."}},
}


def _plan_raster(raster: Any) -> None:
    _, own = place_rasters({"d": raster.middles, "honest": np.array([[48.1, 11.5, 500.0]] * 3)}, _silent())
    assert all(np.isfinite(places).all() for places in own.values())


def _combine(said: dict[str, Any], folder: Path) -> object:
    (folder / "cloud").mkdir(exist_ok=True)
    if not (folder / "cloud" / "summary.json").is_file():
        write_json(folder / "cloud" / "summary.json", {"num_splats": 5})
    claimable = Claimable(num_held_out=2, num_dealt=6, edges=("north", "south"))
    scores = admit_scores(said, lambda device: claimable, lambda device, message: message.encode())
    if not any(each.images for each in scores.values()):
        return REFUSED
    figures = combine_figures(folder, scores, None)
    assert 0 <= figures["psnr_db"] <= 60 and len(figures["images"]) <= 2
    json.dumps(figures, allow_nan=False)
    return None


def _report(kind: str, record: dict[str, Any], use: Callable[[Any, Path], object]) -> Callable[[Path], Kind]:
    def receive(folder: Path) -> object:
        check_result(kind, folder, ["report.json"])
        report = open_report(kind, folder, "gps")
        for reason in report.missing.values():
            assert reason.isprintable()
        return use(report.records, folder) if report.records else REFUSED

    files = {"report.json": {"found": {"d": record}, "missing": {"e": "it is late."}}, "task.json": {"devices": ["d", "e"]}}
    return lambda folder: _in_folder(folder, files, "report.json", receive)


def _notes(folder: Path) -> Kind:
    def use(place: Path) -> None:
        settle_notes(place, "devices/d")
        manifest = _Unsaved(folder=place, config={})
        for event in read_notes(place, "devices/d"):
            manifest.record(event, 1.0)
        manifest.save()

    return _in_folder(folder, {"notes.json": NOTES}, "notes.json", use)


def _task(kind: str) -> Callable[[Path], Kind]:
    train, move = train_preset("draft"), Move.of(Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3)))
    sfm = SfmSettings(matching="exhaustive", seed=0)
    tasks: dict[str, Any] = {
        "count": CountTask(frames="gps"),
        "raster": RasterTask(frames="gps", cell_m=5.0, first_held_out=1),
        "own_field": OwnFieldTask(train=train, backend="native", frames="gps", first_held_out=0, origin=(48.0, 11.0, 500.0), sfm=sfm),
        "score": ScoreTask(corrections=(move,), long_side_px=96, backend="native", lpips=None, light="none", owned=True, versions=("cut",)),
        "edge_count": EdgeCountTask(frames="gps", devices=("d",)),
        "edge_raster": EdgeRasterTask(frames="gps", devices=("d",), cell_m=5.0, first_held_out=(0,)),
        "edge_refine": EdgeRefineTask(devices=("d",), to_cloud=move, joined="0" * 64),
        "edge_score": EdgeScoreTask(devices=("d",), to_cloud=move, versions=("joined", "cut")),
    }

    def make(folder: Path) -> Kind:
        save_task(folder, tasks[kind])
        kinds = {**TASKS, **EDGE_TASKS}
        return _in_folder(folder, {}, "task.json", lambda place: load_task(kinds[kind], place, kind))

    return make


def _poll(folder: Path) -> Kind:
    world = World(folder)
    body = {**json.loads(poll_body()), "task": world.task.digest, "tries": 1, "batch": 1, "events": ["{}"]}
    ended = {"message": "m", "exit_code": 2, "crashed": False, "cannot_write": False}

    def receive(data: bytes) -> object:
        reply = world.answer(world.sealed("POST", "/poll", data))
        assert reply.status < 500 or reply.status in (502, 507)
        return None if reply.status == 200 else REFUSED

    return Kind(seeds=[json.dumps(body).encode(), json.dumps({**body, "ended": ended}).encode()], receive=receive)


def _join(folder: Path) -> Kind:
    world = World(folder)
    body = {"token": "word", "key": base64.b64encode(world.key.public_key().public_bytes_raw()).decode(), "software": "1"}

    def receive(data: bytes) -> object:
        reply = world.answer(world.sealed("POST", "/join", data))
        assert reply.status < 500 or reply.status in (502, 507)
        return None if reply.status == 200 else REFUSED

    return Kind(seeds=[json.dumps(body).encode()], receive=receive)


def _answers(_: Path) -> Kind:
    answer = {
        "verdict": {"state": "refused", "reason": "why", "tries": 2},
        "task": {"text": "e30=", "signature": "A" * 88, "tries": 1, "refused": True},
        "wait_s": 2.0,
    }

    def receive(data: bytes) -> None:
        try:
            record = parse_json(data)
        except (ValueError, RecursionError):
            record = {}  # as `Answer.record`
        said = parse_record(PollAnswer, record, "what cloud answers")
        assert 0 <= said.wait_s <= 3600 and (said.verdict is None or said.verdict.reason.isprintable())

    return Kind(seeds=[json.dumps(answer).encode()], receive=receive)


def _envelope() -> Envelope:
    return Envelope(
        run=RUN,
        sender="edges/north",
        receiver="devices/d",
        kind="count",
        stage="devices/d/count",
        attempt=1,
        answers="",
        software="1",
        files={"task.json": SentFile(bytes=2, sha256="0" * 64)},
    )


def _envelopes(_: Path) -> Kind:
    key = Ed25519PrivateKey.generate()

    def receive(data: bytes) -> None:
        open_envelope(data, key.sign(b"radiant.envelope 1\0" + data), key.public_key())

    return Kind(seeds=[envelope_bytes(_envelope()), envelope_bytes(replace(_envelope(), files={}))], receive=receive)


def _pack_lists(folder: Path) -> Kind:
    """The list of a pack, signed as it is."""
    key = Ed25519PrivateKey.generate()

    def receive(data: bytes) -> None:
        (folder / LIST_NAME).write_bytes(data)
        (folder / SIGNATURE_NAME).write_bytes(key.sign(b"radiant.envelope 1\0" + data))
        pack = open_pack(folder, [key.public_key()])
        pack.check()

    (folder / "files").mkdir()
    (folder / "files" / "task.json").write_bytes(b"{}")
    whole = replace(_envelope(), files=describe_files({"task.json": folder / "files" / "task.json"}))
    return Kind(seeds=[envelope_bytes(whole)], receive=receive)


def _pack_joins(folder: Path) -> Kind:
    write_join(folder, {"x-radiant-node": "edges/north", "content-length": "3"}, b"abc")
    return _in_folder(folder, {}, "join.json", read_join)


def _invitations(folder: Path) -> Kind:
    cloud = make_home(folder / "cloud", listening(8443))
    home = make_home(folder / "edge", None)
    text = invitation_text(new_invitation(cloud, "north"))

    def receive(data: bytes) -> None:
        (folder / "north.join").write_bytes(data)
        (home.folder / "upper.json").unlink(missing_ok=True)
        accept_invitation(home, folder / "north.join")
        assert home.upper.node

    return Kind(seeds=[text.encode()], receive=receive)


def _model(name: str) -> Callable[[Path], Kind]:
    def make(folder: Path) -> Kind:
        save_upload(folder / "model.safetensors", ground_splats(3), "float16")
        save_cameras(folder / "cameras.safetensors", cameras_above([(0.0, 0.0), (1.0, 0.5)]))
        (folder / "frame.json").write_text(json.dumps(FRAME))
        return _in_folder(folder, {}, name, lambda place: REFUSED if isinstance(load_device_model(place), str) else None)

    return make


def _refinement(name: str) -> Callable[[Path], Kind]:
    def make(folder: Path) -> Kind:
        scene = ground_splats(8)
        rows = np.array([1, 4])
        one = Refinement(rows=rows, splats=scene.select(rows), weights=np.array([0.5, 1.0], np.float32))
        save_refinement(folder, one, scene, "float16", lambda message: None)
        return _in_folder(folder, {}, name, lambda place: REFUSED if isinstance(load_refinement(place, scene, 6), str) else None)

    return make


KINDS: dict[str, Callable[[Path], Kind]] = {
    "events": _events,
    "notes": _notes,
    "count": _of_result("count", {"count.json": {"num_photographs": 6}}, "count.json"),
    "raster": _of_result("raster", {"raster.json": RASTER, "task.json": {"frames": "gps"}}, "raster.json"),
    "frame": _of_result("own_field", FIELD, "frame.json"),
    "summary": _of_result("own_field", FIELD, "summary.json"),
    "scores": _of_result(
        "score",
        {"scores.json": SCORES},
        "scores.json",
        lambda folder: _combine({"d": folder / "scores.json"}, folder),
    ),
    "corrections": _of_result("region", REGION, "corrections.json", load_corrections),
    "refused": _of_result("region", REGION, "refused.json"),
    "report of counts": _report("edge_count", {"num_photographs": 6}, lambda found, _: [range(number) for number in found.values()]),
    "report of rasters": _report("edge_raster", RASTER, lambda found, _: [_plan_raster(raster) for raster in found.values()]),
    "report of a region": _report(
        "region",
        {"frame": FRAME, "summary": SUMMARY},
        lambda found, _: json.dumps([told.model_dump() for told in found.values()], allow_nan=False),
    ),
    "report of refining": _report("edge_refine", {}, lambda found, _: None),
    "report of scores": _report("edge_score", SCORES, _combine),
    **{f"task {kind}": _task(kind) for kind in TASK_KINDS},
    "polls": _poll,
    "requests to join": _join,
    "answers": _answers,
    "envelopes": _envelopes,
    "lists of packs": _pack_lists,
    "requests in packs": _pack_joins,
    "invitations": _invitations,
    "model": _model("model.safetensors"),
    "cameras": _model("cameras.safetensors"),
    "frame of a model": _model("frame.json"),
    "refinement": _refinement("refined.safetensors"),
    "rows of a refinement": _refinement("rows.safetensors"),
}


def main() -> None:
    """Fuzz one kind, or all, and tell."""
    names, count = ([sys.argv[1]] if len(sys.argv) > 1 and sys.argv[1] in KINDS else [*KINDS]), int(sys.argv[-1])
    for name in names:
        with memory_folder() as folder:
            report = fuzz_messages(name, count, SEED, folder)
        said = f"{name}: {report.count:,} in {report.seconds:.0f} s, {report.num_refused:,} refused"
        longest = f"the longest {1000 * report.longest_s:.0f} ms"
        print(f"{said}, {longest}, {len(report.surprises)} surprises", *report.surprises, sep="\n    ", flush=True)


if __name__ == "__main__":
    main()
