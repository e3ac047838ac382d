"""Every kind of message and small file of the network: a valid specimen, what parses it, and all that uses what passes.

    Kind.open(folder) → Message      specimen; parse(bytes): raises one of REFUSALS, or returns what `use` must accept

This is the one place to adapt where a parser or what reads after it changes. What is binary (models, cameras, scenes, plans) is in
`reader_fuzz.py`.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from rich.console import Console

from radiant_app.commands import node as node_commands
from radiant_app.events import Decided, Event, MemoryPeaked, StageDone, StageProgress, StageStarted, Warned, decode, encode
from radiant_app.executors.network import admit_event, ended_of
from radiant_app.files.event_file import EventFile, read_progress
from radiant_app.files.run_folder import Manifest, read_manifest
from radiant_app.network import line as lines
from radiant_app.network.contents import check_result, load_report
from radiant_app.network.errands import MAX_POLL_S, MIN_POLL_S, Errands
from radiant_app.network.home import accept_invitation, make_home, open_home
from radiant_app.network.kinds import NOTES_NAME, REPORT_NAME, RESULT_FILES
from radiant_app.network.line import Answer, Line
from radiant_app.network.messages import EDGE_TASKS, EdgeCountTask, EdgeRasterTask, EdgeRefineTask, EdgeScoreTask, RegionTask
from radiant_app.network.packs import open_pack, read_join, write_join
from radiant_app.network.receiving import open_desk
from radiant_app.network.reception import Refused
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.captured import middles_of_raster, place_rasters
from radiant_app.run.choosing import keep_best
from radiant_app.run.far_devices import FarDevices
from radiant_app.run.scoring import combine_scores
from radiant_app.workers.inbox import load_corrections
from radiant_app.workers.reporting import read_notes
from radiant_app.workers.tasks import TASKS, Move, SfmSettings
from radiant_core import __version__
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.decisions import Decision
from radiant_core.errors import RadiantError
from radiant_core.frames import Sim3
from radiant_core.io.messages import FRAME_NAME, SUMMARY_NAME, load_task, load_uncertainty, message_record, save_task, task_key
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.delivery import _DOMAIN as DELIVERY_DOMAIN
from radiant_core.io.transport.delivery import Delivery, SentFile, save_delivery, verify_delivery
from radiant_core.io.transport.envelope import _ENVELOPE as ENVELOPE_DOMAIN
from radiant_core.io.transport.envelope import Envelope, envelope_bytes, open_envelope
from tests.app.network_nodes import listening
from tests.app.network_transfer import RUN, make_edge
from tests.app.test_network_reception import World
from tests.app.test_task_schema import MESSAGES, TRAIN

REFUSALS: tuple[type[Exception], ...] = (RadiantError, Refused)
MANY = 10**6
"""Photographs that no device has: what takes memory for each of so many is a surprise."""
NODE = "devices/d"


@dataclass(frozen=True, kw_only=True)
class Message:
    """A kind that is ready to be parsed."""

    specimen: bytes
    parse: Callable[[bytes], Any]
    use: Callable[[Any], None] = lambda value: None


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of message."""

    name: str
    open: Callable[[Path], Any]
    """A context of its `Message`, in an empty folder."""


def _plain(open_: Callable[[Path], Message]) -> Callable[[Path], Any]:
    @contextmanager
    def opened(folder: Path) -> Iterator[Message]:
        yield open_(folder)

    return opened


def _json(record: Any) -> bytes:
    return json.dumps(record).encode()


def _as_ours(data: bytes) -> bytes:
    """Three of four mutated lists as one writes them who signs them: any other text is refused at once."""
    try:
        return data if len(data) % 4 == 0 else json.dumps(json.loads(data), sort_keys=True, separators=(",", ":")).encode()
    except (ValueError, RecursionError):
        return data


def require(fact: bool, what: str) -> None:
    """As `assert`, with a word that the report shows."""
    if not fact:
        raise AssertionError(what)


# Events

DECISION = Decision(stage=NODE, topic="matching", choice="each pair", figure=3.5, unit="s", reason="few photographs")
EVENTS: Mapping[str, Event] = {
    "StageStarted": StageStarted(stage=NODE),
    "StageProgress": StageProgress(stage=NODE, done=1.0, total=4.0, note="3 of 4", phase="matching", step=2, num_steps=5, left_s=9.0),
    "StageDone": StageDone(stage=NODE, seconds=3.5),
    "MemoryPeaked": MemoryPeaked(stage=NODE, peak_bytes=10**9),
    "Warned": Warned(stage=NODE, message="a photograph is blurred."),
    "Decided": Decided(decision=DECISION),
}
"""Those that members send; of the others `decode` is tried."""
OTHERS: Mapping[str, dict[str, Any]] = {
    "Outlined": {"stages": ["sfm", NODE]},
    "TimeLeft": {"seconds": 4.0, "correction": 1.1, "after": NODE},
    "StageSkipped": {"stage": NODE, "emulated": False},
    "Failed": {"stage": NODE, "message": "no photograph.", "exit_code": 2, "cannot_write": False},
    "Heartbeat": {"stage": NODE},
}


def hear(folder: Path) -> Callable[[Sequence[Event]], None]:
    """All that hears events of members: manifest, stream, terminal, and what reads these afterwards."""
    manifest = Manifest(folder=folder, config={})
    clock = iter(range(10**9)).__next__

    def use(events: Sequence[Event]) -> None:
        said = StringIO()
        display = ProgressDisplay(Console(file=said, width=100), clock=lambda: float(100 * clock()))
        for kept in (manifest.stages, manifest.decisions, manifest.warnings, manifest.peak_bytes):
            kept.clear()
        with EventFile(folder, display) as file:
            for event in events:
                require(decode(encode(event)) == event, "another event is read than was written")
                manifest.record(event, 3.0)
                file(event)
        manifest.save()
        read_manifest(folder)
        read_progress(folder)
        require(all(letter.isprintable() or letter == "\n" for letter in said.getvalue()), "a control character in the terminal")

    return use


def _event(name: str) -> Callable[[Path], Message]:
    def message(folder: Path) -> Message:
        use = hear(folder)

        def parse(data: bytes) -> Sequence[Event]:
            # As `PollBody` has it: a text.
            line = data.decode("utf-8", errors="replace")
            begun = {NODE} if name == "StageDone" else set[str]()
            if not (events := admit_event(line, NODE, begun)):
                raise Refused(400, "it is not heard.")
            return [StageStarted(stage=NODE), *events]

        return Message(specimen=encode(EVENTS[name]).encode(), parse=parse, use=use)

    return message


def _other_event(name: str) -> Callable[[Path], Message]:
    def message(folder: Path) -> Message:
        def use(event: Event) -> None:
            require(decode(encode(event)) == event, "another event is read than was written")
            require(admit_event(encode(event), NODE, set()) == [], "a member sends what only a worker may")

        return Message(
            specimen=_json({"event": name, **OTHERS[name]}), parse=lambda data: decode(data.decode("utf-8", errors="replace")), use=use
        )

    return message


# What nodes say to the one above


def _replied(world: World, method: str, target: str, body: bytes) -> str:
    """Ask as the member; raises Refused where the answer is one. The reply is always JSON."""
    reply = world.answer(world.sealed(method, target, body))
    record = json.loads(reply.body)
    require(reply.status in (200, 400, 403, 404, 409, 410, 413, 415, 507), f"status {reply.status}: {record}")
    if reply.status != 200:
        raise Refused(reply.status, record["reason"])
    return record


def _look(world: World) -> None:
    """Who looks at the hub afterwards."""
    record = node_commands.status(world.home.folder)
    require(all(line.isprintable() for line in node_commands.status_lines(record)), "a control character in the status")
    json.dumps(record, allow_nan=False)


@contextmanager
def _poll(folder: Path) -> Iterator[Message]:
    world, hearing = World(folder), hear(folder)
    ended = {"message": "no photograph.", "exit_code": 2, "crashed": False, "cannot_write": False}
    body = {"software": __version__, "task": world.task.digest, "tries": 1, "doing": "count: working", "ended": ended}
    body |= {"batch": 1, "events": [encode(StageStarted(stage="edges/north/count"))]}

    def parse(data: bytes) -> Any:
        world.heard.clear()
        world.store.note("edges/north", "", __version__)
        # As if nothing had been said yet, so that every body is heard.
        with world.store._changing(forced=False) as database:
            database.execute("update nodes set batch = 0")
            database.execute("update tasks set state = 'offered', reason = '', tries = 1")
        return _replied(world, "POST", "/poll", data)

    def use(answer: Any) -> None:
        _look(world)
        for said in world.heard:
            begun = set[str]()
            hearing(
                [
                    StageStarted(stage="edges/north/count"),
                    *(each for line in said.events for each in admit_event(line, "edges/north", begun)),
                ]
            )
            if said.ended is not None:
                require(str(ended_of("edges/north/count", said.ended).error).isprintable(), "a control character in a reason")

    yield Message(specimen=_json(body), parse=parse, use=use)
    world.store.close()


@contextmanager
def _join(folder: Path) -> Iterator[Message]:
    world = World(folder)
    raw = base64.b64encode(world.key.public_key().public_bytes_raw()).decode()

    def parse(data: bytes) -> Any:
        world.store.invite("edges/north", "word")
        return _replied(world, "POST", "/join", data)

    yield Message(specimen=_json({"token": "word", "key": raw, "software": __version__}), parse=parse, use=lambda answer: _look(world))
    world.store.close()


@contextmanager
def _announcement(folder: Path) -> Iterator[Message]:
    """Signed by the member, whatever it says."""
    world = World(folder)
    target, text = f"/results/{world.task.digest}", world.announcement()[64:]

    def use(answer: Any) -> None:
        _look(world)
        require(len(answer["offsets"]) == 1 and world.kept() == 0, "other files than a result has")
        reply = world.answer(world.part(0, b"part"))
        require(reply.status in (200, 409, 507), f"a part is answered {reply.status} {reply.body[:200]!r}")
        world.arrivals.remove(world.task.digest)

    yield Message(
        specimen=text,
        parse=lambda data: _replied(world, "POST", target, world.key.sign(ENVELOPE_DOMAIN + (ours := _as_ours(data))) + ours),
        use=use,
    )
    world.store.close()


# What nodes hear from the one above


class _Told:
    """A way whose answers are what a test says; see `Way`."""

    def __init__(self, line: Line) -> None:
        self.line, self.upper, self.ended, self.counter = line, line.upper, line.ended, 1
        self.answer: Any = {}

    def enter(self) -> None: ...

    def close(self) -> None: ...

    def poll(self, body: Mapping[str, Any]) -> Any:
        json.dumps(body, allow_nan=False)
        return self.answer

    def fetch(self, envelope: Envelope, digest: str, folder: Path) -> None: ...

    def send(self, result: Envelope, paths: Mapping[str, Path]) -> None: ...


class _Idle:
    """A performer whose work goes on; see `Performer`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def place(self, envelope: Envelope) -> Path:
        return self.folder

    def begin(self, envelope: Envelope, folder: Path, digest: str) -> Any:
        return SimpleNamespace(heard=list, outcome=lambda: None, stop=lambda: None, result=dict)


def _device(folder: Path) -> tuple[Line, Ed25519PrivateKey]:
    make_edge(folder, 8443, 8443, ["d"])
    return Line(home=open_home(folder / "d")), open_home(folder / "north").key


def _task_envelope() -> Envelope:
    files = {name: SentFile(bytes=2, sha256="a" * 64) for name in ("task.json", "given/delivery.json", "given/delivery.sig")}
    return Envelope(run=RUN, sender="edges/north", receiver=NODE, kind="own_field", stage=NODE, attempt=1, answers="",
                    software=__version__, files=files)  # fmt: skip


def _errands(folder: Path) -> tuple[Errands, _Told, Ed25519PrivateKey, list[str]]:
    line, key = _device(folder)
    told, said = _Told(line), list[str]()
    return Errands(home=line.home, line=told, performer=_Idle(folder), say=said.append), told, key, said


def _round(errands: Errands, told: _Told, answer: Any, said: list[str]) -> None:
    """Two rounds: the second reports what came of the first."""
    said.clear()
    for _ in range(2):
        told.answer = answer
        wait_s = errands._round()
        require(0.0 < min(max(wait_s, MIN_POLL_S), MAX_POLL_S) <= MAX_POLL_S, "no time to wait")
    outcome = errands.current.outcome if errands.current is not None else None
    errands._drop()
    require(all(text.isprintable() for text in said), "a control character in the terminal")
    if outcome is not None and outcome.error is not None:
        raise outcome.error


def _sealed_text(envelope: bytes, key: Ed25519PrivateKey) -> dict[str, Any]:
    text, signature = (base64.b64encode(data).decode() for data in (envelope, key.sign(ENVELOPE_DOMAIN + envelope)))
    return {"text": text, "signature": signature, "tries": 1, "refused": False}


def _task(folder: Path) -> Message:
    """The list of a task, signed by the node above, whatever it says."""
    errands, told, key, said = _errands(folder)

    def parse(data: bytes) -> None:
        (folder / "d" / "runs" / RUN / "asked.json").unlink(missing_ok=True)
        _round(errands, told, {"verdict": None, "task": _sealed_text(_as_ours(data), key), "wait_s": 1.0}, said)

    return Message(specimen=envelope_bytes(_task_envelope()), parse=parse)


def _answer(folder: Path) -> Message:
    """The answer to a poll."""
    errands, told, key, said = _errands(folder)
    verdict = {"state": "taken", "reason": "", "tries": 1}
    specimen = {"verdict": verdict, "task": _sealed_text(envelope_bytes(_task_envelope()), key), "wait_s": 2.0}

    def parse(data: bytes) -> None:
        answer = lines._accepted(Answer(status=200, body=data, headers={}))
        _round(errands, told, answer, said)

    return Message(specimen=_json(specimen), parse=parse)


def _offsets(folder: Path) -> Message:
    """The answer to an announcement."""
    line, _ = _device(folder)
    paths = {}
    for name in ("notes.json", "count.json"):
        paths[name] = folder / name
        paths[name].write_bytes(b"0123456789")
    files = {name: SentFile(bytes=10, sha256="a" * 64) for name in paths}
    result = replace(_task_envelope(), kind="count", stage=f"{NODE}/count", files={"task.json": SentFile(bytes=2, sha256="a" * 64)})
    result = result.result(files, __version__)

    def parse(data: bytes) -> None:
        bodies = iter([data, _json({"offsets": [10, 10]})])

        def ask(method: str, target: str, body: bytes = b"", headers: Any = None) -> Answer:
            return Answer(status=200, body=next(bodies), headers={})

        def ask_once(method: str, target: str, body: bytes = b"", headers: Any = None) -> Answer:
            require(method == "PATCH" and 0 < len(body) <= 10, "a part without bytes")
            offset = int(target.partition("offset=")[2]) + len(body)
            return Answer(status=200, body=b"", headers={"upload-offset": str(offset)})

        line.ask, line.ask_once = ask, ask_once  # type: ignore[method-assign]
        line.send(result, paths)

    return Message(specimen=_json({"offsets": [0, 4]}), parse=parse)


def _refusal(folder: Path) -> Message:
    """Why the node above refuses something."""
    del folder

    def parse(data: bytes) -> str:
        return Answer(status=409, body=data, headers={}).reason

    return Message(
        specimen=_json({"reason": "the join file of devices/d is used up."}),
        parse=parse,
        use=lambda reason: require(reason.isprintable() and len(reason) <= 1000, "a reason that is no line"),
    )


def _invitation(folder: Path) -> Message:
    make_edge(folder, 8443, 8443, ["d"])
    specimen, number = (folder / "d.join").read_bytes(), iter(range(10**9))

    def parse(data: bytes) -> Any:
        (folder / "x.join").write_bytes(data)
        home = make_home(folder / "new", None) if next(number) == 0 else open_home(folder / "new")
        (home.folder / "upper.json").unlink(missing_ok=True)
        accept_invitation(home, folder / "x.join")
        return home

    def use(home: Any) -> None:
        require(home.node == home.upper.node and all(getattr(home.upper, name).isprintable() for name in ("url", "node", "upper")), "shown")
        lines.join_body(home)

    return Message(specimen=specimen, parse=parse, use=use)


# Packs


@contextmanager
def _pack_join(folder: Path) -> Iterator[Message]:
    make_edge(folder, 8443, 8443, ["d"])
    from radiant_app.network.carrying import sealed_join

    (folder / "disk").mkdir()
    write_join(folder / "disk", *sealed_join(open_home(folder / "d")))
    specimen = (folder / "disk" / "join.json").read_bytes()
    with open_desk(open_home(folder / "north")) as desk:

        def parse(data: bytes) -> str:
            (folder / "disk" / "join.json").write_bytes(data)
            request = read_join(folder / "disk")
            assert request is not None
            return desk.take_join(*request)

        yield Message(specimen=specimen, parse=parse, use=lambda node: require(node == NODE, "another node"))


def _pack_list(folder: Path) -> Message:
    key = Ed25519PrivateKey.generate()
    (folder / "files").mkdir()

    def parse(data: bytes) -> Any:
        data = _as_ours(data)
        (folder / "list.json").write_bytes(data)
        (folder / "list.sig").write_bytes(key.sign(ENVELOPE_DOMAIN + data))
        return open_pack(folder, [key.public_key()])

    def use(pack: Any) -> None:
        require(all(path.resolve().is_relative_to(folder.resolve() / "files") for path in pack.files.values()), "a file beside its pack")
        open_envelope(pack.text, pack.signature, key.public_key())

    return Message(specimen=envelope_bytes(_task_envelope()), parse=parse, use=use)


def _delivery(folder: Path) -> Message:
    make_home(folder / "home", listening())
    key = open_home(folder / "home").key
    files = {name: SentFile(bytes=5, sha256="b" * 64) for name in ("model.safetensors", "cameras.safetensors")}
    delivery = Delivery(run=RUN, sender=NODE, receiver="edges/north", kind="device_model", attempt=1, files=files)
    save_delivery(folder, delivery, folder / "home" / "identity")

    def use(found: Delivery) -> None:
        save_delivery(folder, found, folder / "home" / "identity")
        require(len(found.digest) == 64, "no digest")

    return Message(
        specimen=(folder / "delivery.json").read_bytes(),
        parse=lambda data: verify_delivery(data, key.sign(DELIVERY_DOMAIN + data), key.public_key()),
        use=use,
    )


# Tasks

MOVE = Move.of(Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3)))
DEVICES: dict[str, Any] = {"frames": "gps", "devices": ("d", "c")}
EDGE_MESSAGES: Mapping[str, Any] = {
    "edge_count": EdgeCountTask(**DEVICES),
    "edge_raster": EdgeRasterTask(**DEVICES, cell_m=5.0, first_held_out=(0, 3)),
    "region": RegionTask(
        **DEVICES,
        train=TRAIN,
        backend="native",
        first_held_out=(0, 3),
        num_dealt=(9, 9),
        origin=(45.0, 7.5, 300.0),
        sfm=SfmSettings(matching="auto", seed=0),
        aggregate=AggregateConfig(),
        upload="float16",
        step_policy="fixed",
        num_devices=2,
        num_photographs=18,
        deadline_factor=2.0,
        lpips=None,
    ),
    "edge_refine": EdgeRefineTask(devices=("d",), to_cloud=MOVE, joined="0" * 64, number=2),
    "edge_score": EdgeScoreTask(devices=("d",), to_cloud=MOVE, versions=("refined", "joined")),
}
TRAVELLING = {name: MESSAGES[name] for name in ("field", "count", "raster", "own_field", "edge", "score", "refine", "average")}


def _task_file(name: str, kind: type[Any], task: Any) -> Callable[[Path], Message]:
    def message(folder: Path) -> Message:
        save_task(folder, task)

        def parse(data: bytes) -> Any:
            (folder / "task.json").write_bytes(data)
            return load_task(kind, folder, name)

        def use(found: Any) -> None:
            save_task(folder, found)
            require(message_record(load_task(kind, folder, name)) == message_record(found), "another task is read than was written")
            json.dumps(task_key(found), allow_nan=False)

        return Message(specimen=(folder / "task.json").read_bytes(), parse=parse, use=use)

    return message


# Results

NOTES = {"decisions": [DECISION.__dict__], "warnings": ["a photograph is blurred."]}
COUNT = {"num_photographs": 17}
RASTER = {"cells": [[47.1, 8.5, 9], [47.1001, 8.5, 6]], "altitude_m": 410.0, "num_photographs": 17, "num_unplaced": 1}
ROW = {"name": "d/0.png", "psnr_db": 24.0, "ssim": 0.8, "psnr_cc_db": 25.0, "ssim_cc": 0.81, "flip": 0.1, "lpips": None}
BORDER = {"side": "north", "beyond": "south", "before_db": -24.0, "beyond_db": -23.0}
SCORES = {
    "images": [ROW, {**ROW, "name": "d/1.png"}],
    "borders": [BORDER] * 4 + [{**BORDER, "side": "south", "beyond": "north"}] * 4,
    "leakage": {"psnr_db": 20.0, "ssim": 0.7, "num_images": 9},
    "versions": {"refined": [24.0, 24.0], "joined": [23.0, 23.0]},
}
HONEST = {**SCORES, "images": [{**ROW, "name": "c/0.png"}], "versions": {"refined": [24.0], "joined": [23.0]}}
FRAME = {"status": "placed", "reason": "", "uncertainty": {"position_m": 0.1, "rotation_rad": 0.01, "scale": 0.01}}
SUMMARY = {"num_splats": 100, "model_bytes": 5000, "num_steps": 40, "train_s": 3.5, "first_loss": 0.3, "last_loss": 0.1}
CORRECTION = {"scale": 1.0, "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "translation": [0.0, 0.0, 0.0]}
CORRECTIONS = {"d": CORRECTION, "c": None}
SMALL: Mapping[str, Any] = {
    NOTES_NAME: {"decisions": [], "warnings": []}, "count.json": COUNT, "raster.json": RASTER, "scores.json": SCORES, FRAME_NAME: FRAME,
    SUMMARY_NAME: SUMMARY, "corrections.json": CORRECTIONS, "refused.json": {"c": "it has no Gaussian."},
    REPORT_NAME: {"found": {}, "missing": {}},
}  # fmt: skip


def use_scores(folder: Path) -> Callable[[Any], None]:
    """A device's scores beside an honest one's: chosen by, combined, written, shown."""
    run = folder / "run"
    (run / "cloud").mkdir(parents=True)
    write_json(run / "cloud" / SUMMARY_NAME, SUMMARY)
    scores = {"d": folder / "d.json", "c": folder / "c.json"}
    write_json(scores["c"], HONEST)
    dealer: Any = SimpleNamespace(versions={"refined": run, "joined": run / "cloud"}, chosen=None, version="refined")

    def use(record: Any) -> None:
        write_json(scores["d"], record)
        events: list[Event] = []
        kept, facts = keep_best(dealer, lambda scenes: scores, events.append)
        metrics = {**combine_scores(run, kept, None), **facts}
        write_json(run / "metrics.json", metrics)
        require("c/0.png" in [row["name"] for row in metrics["images"]], "the honest device's figures are lost")
        for row in metrics["images"]:
            place = (run / "pictures" / "photographs" / f"{row['name']}.png").resolve()
            require(place.is_relative_to(run.resolve() / "pictures"), "a picture of another folder of the owner")

    return use


def use_raster(folder: Path) -> Callable[[Any], None]:
    """A device's raster beside an honest one's."""
    del folder

    def use(record: Any) -> None:
        require(sum(count for _, _, count in record["cells"]) < MANY, f"memory for {MANY} photographs and more")
        progress: Any = SimpleNamespace(listen=lambda event: json.dumps(encode(event)))
        honest = middles_of_raster(RASTER)
        origin, cells = place_rasters({"c": honest, "d": middles_of_raster(record)}, progress)
        require(bool(np.isfinite(origin).all() and np.isfinite(cells["d"]).all()), "no place")
        require(len(cells["c"]) == len(honest) or len(cells["d"]) > len(honest), "an honest device is left out")

    return use


def use_count(folder: Path) -> Callable[[Any], None]:
    """A device's count beside an honest one's."""
    del folder

    def use(record: Any) -> None:
        devices = FarDevices(counts={"c": 17, "d": record["num_photographs"]})
        require(devices.num_dealt("d") + devices.num_held_out("d") == record["num_photographs"], "photographs are lost")

    return use


def use_model(folder: Path) -> Callable[[Any], None]:
    """What is read of a device's or edge's frame and figures after it was taken."""

    def use(record: Any) -> None:
        place = folder / "laid"
        place.mkdir(exist_ok=True)
        write_json(place / FRAME_NAME, record["frame"])
        write_json(place / SUMMARY_NAME, record["summary"])
        load_uncertainty(place)
        require(isinstance(read_json(place / FRAME_NAME, ("reason",))["reason"], str), "no reason")
        if record["frame"]["status"] == "placed":
            summary = read_json(place / SUMMARY_NAME, ("train_s", "num_steps", "num_splats"))
            write_json(place / "total.json", {"seconds_per_step": float(summary["train_s"]) / max(1, summary["num_steps"])})
            write_json(place / "sum.json", {name: 2 * summary[name] for name in summary})
            int(summary["num_splats"])

    return use


def use_corrections(folder: Path) -> Callable[[Any], None]:
    """How an edge moved its devices' models, as the cloud uses it."""
    del folder

    def use(moved: Mapping[str, Sim3 | None]) -> None:
        for move in moved.values():
            if move is not None:
                Move.of(move).sim3.apply(np.zeros((1, 3)))

    return use


def use_report(kind: str, folder: Path) -> Callable[[Any], None]:
    """What is read of an edge's report."""
    each: Mapping[str, Callable[[Path], Callable[[Any], None]]] = {
        "edge_count": use_count, "edge_raster": use_raster, "edge_score": use_scores, "region": use_model,
    }  # fmt: skip
    consume = each[kind](folder) if kind in each else lambda record: None

    def use(report: Any) -> None:
        for record in report.found.values():
            consume(record)
        json.dumps(report.missing)

    return use


@dataclass(frozen=True)
class _Small:
    """A small file of a result: of which kind, and who reads it afterwards."""

    kind: str
    file: str
    record: Any
    read: Callable[[Path], Any]
    use: Callable[[Path], Callable[[Any], None]]

    def __call__(self, folder: Path) -> Message:
        names = [*RESULT_FILES[self.kind].needed]
        if self.kind == "region":
            names = [REPORT_NAME, FRAME_NAME, SUMMARY_NAME, NOTES_NAME, "corrections.json", "refused.json"]
        if self.kind in ("region", "own_field"):
            names += ["model.safetensors", "cameras.safetensors", "delivery.json", "delivery.sig"]
        if self.kind == "edge_refine":
            names += ["refused.json", NOTES_NAME]
        for name in names:
            if name in SMALL:
                write_json(folder / name, SMALL[name])

        def parse(data: bytes) -> Any:
            (folder / self.file).write_bytes(data)
            check_result(self.kind, folder, names)
            return self.read(folder)

        return Message(specimen=_json(self.record), parse=parse, use=self.use(folder))


def _file(name: str) -> Callable[[Path], Any]:
    return lambda folder: read_json(folder / name, max_bytes=64 << 20)


def _model_files(folder: Path) -> Any:
    return {"frame": read_json(folder / FRAME_NAME), "summary": read_json(folder / SUMMARY_NAME)}


def _report(kind: str, found: Any) -> _Small:
    record = {"found": {"d": found}, "missing": {"c": "it ended."}}
    return _Small(kind, REPORT_NAME, record, load_report, lambda folder: use_report(kind, folder))


def _nothing(folder: Path) -> Callable[[Any], None]:
    return lambda value: None


RESULTS: Mapping[str, _Small] = {
    "notes": _Small("count", NOTES_NAME, NOTES, lambda folder: [StageStarted(stage=NODE), *read_notes(folder, NODE)], hear),
    "count": _Small("count", "count.json", COUNT, _file("count.json"), use_count),
    "raster": _Small("raster", "raster.json", RASTER, _file("raster.json"), use_raster),
    "scores": _Small("score", "scores.json", SCORES, _file("scores.json"), use_scores),
    "frame": _Small("own_field", FRAME_NAME, FRAME, _model_files, use_model),
    "summary": _Small("own_field", SUMMARY_NAME, SUMMARY, _model_files, use_model),
    "edge frame": _Small("region", FRAME_NAME, FRAME, _model_files, use_model),
    "edge summary": _Small("region", SUMMARY_NAME, SUMMARY, _model_files, use_model),
    "corrections": _Small("region", "corrections.json", CORRECTIONS, load_corrections, use_corrections),
    "refused": _Small("edge_refine", "refused.json", SMALL["refused.json"], _file("refused.json"), _nothing),
    "report of counts": _report("edge_count", COUNT),
    "report of rasters": _report("edge_raster", RASTER),
    "report of a region": _report("region", {"frame": FRAME, "summary": SUMMARY}),
    "report of refinements": _report("edge_refine", {}),
    "report of scores": _report("edge_score", SCORES),
}

OPENED: Mapping[str, Callable[[Path], Any]] = {
    **{f"event {name}": _plain(_event(name)) for name in EVENTS},
    **{f"event {name}": _plain(_other_event(name)) for name in OTHERS},
    "poll": _poll,
    "join": _join,
    "announcement": _announcement,
    "task": _plain(_task),
    "answer to a poll": _plain(_answer),
    "answer to an announcement": _plain(_offsets),
    "refusal": _plain(_refusal),
    "join file": _plain(_invitation),
    "pack's list": _plain(_pack_list),
    "pack's request to join": _pack_join,
    "record of a delivery": _plain(_delivery),
    **{f"task of {name}": _plain(_task_file(name, TASKS[name], task)) for name, task in TRAVELLING.items()},
    **{f"task of {name}": _plain(_task_file(name, EDGE_TASKS[name], task)) for name, task in EDGE_MESSAGES.items()},
    **{name: _plain(small) for name, small in RESULTS.items()},
}
KINDS: Mapping[str, Kind] = {name: Kind(name=name, open=opened) for name, opened in OPENED.items()}
