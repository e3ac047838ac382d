"""Tasks and results that go by a disk: what is altered, another's, old or not whole is refused, and nothing of it is kept."""

from __future__ import annotations

import hashlib
import json
import resource
import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.network import node as commands
from radiant_app.commands.network import packs as node_packs
from radiant_app.network import carrying, packs
from radiant_app.network.arrivals import INCOMING, SPARE_BYTES, Arrivals
from radiant_app.network.carrying import CarriedWay
from radiant_app.network.errands import Errands, Outcome
from radiant_app.network.home import make_home, open_home
from radiant_app.network.hub import Hub
from radiant_app.network.store import HubStore
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed
from radiant_core.hierarchy.codec import MODEL_NAME
from radiant_core.io.transport.envelope import Envelope
from tests.app.network_transfer import RUN, TASK, make_edge, write_model
from tests.memory_folder import memory_folder

SIZE = 300_000


class Performer:
    """A device whose work is done, or fails, at once."""

    def __init__(self, folder: Path, error: RadiantError | None = None) -> None:
        self.folder, self.error, self.begun = folder, error, 0

    def place(self, envelope: Envelope) -> Path:
        return self.folder / "place"

    def begin(self, envelope: Envelope, folder: Path, digest: str) -> Performer:
        self.begun += 1
        return self

    def heard(self) -> list:
        return []

    def outcome(self) -> Outcome:
        return Outcome(error=self.error)

    def stop(self) -> None:
        pass

    def result(self) -> dict[str, Path]:
        return {path.name: path for path in (self.folder / "model").iterdir()}


class Road:
    """An edge and a device that no cable joins; what is carried lies in `disk`."""

    def __init__(self, folder: Path, devices: tuple[str, ...] = ("d",)) -> None:
        self.folder, self.disk = folder, folder / "disk"
        make_edge(folder, 8443, 8443, list(devices))
        (folder / "north" / INCOMING).mkdir()
        self.store = HubStore(folder=folder / "north")
        home = open_home(folder / "north")
        self.hub = Hub(home=home, store=self.store, arrivals=Arrivals(folder=home.folder / INCOMING))
        write_model(folder / "model", SIZE, 1)
        self.digests = {device: self.ask(device) for device in devices}

    def ask(self, device: str = "d", text: str = "{}") -> str:
        place = self.folder / "asked" / device
        for name in TASK:
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_text(text)
        return self.hub.offer(RUN, f"devices/{device}", "own_field", f"devices/{device}", place).digest

    def join(self, device: str = "d") -> None:
        node_packs.pack(self.folder / device, None, self.disk)
        assert node_packs.unpack(self.folder / "north", self.disk) == [f"devices/{device} has joined."]

    def task(self, device: str = "d") -> None:
        node_packs.pack(self.folder / "north", device, self.disk)

    def work(self, device: str = "d", error: RadiantError | None = None) -> Performer:
        performer = Performer(self.folder, error)
        home = open_home(self.folder / device)
        Errands(home=home, line=CarriedWay(home=home), performer=performer).run()
        return performer

    def result(self, device: str = "d") -> None:
        """Everything up to a result on the disk."""
        self.join(device)
        self.task(device)
        node_packs.unpack(self.folder / device, self.disk)
        assert self.work(device).begun == 1
        node_packs.pack(self.folder / device, None, self.disk)

    def state(self, device: str = "d") -> str:
        task = self.store.task(self.digests[device])
        assert task is not None
        return task.state

    def kept(self, device: str = "d") -> dict[str, str]:
        """What arrived at the edge, and what a device keeps of tasks; by hash."""
        places = [self.hub.arrivals.folder, self.folder / device / carrying.CARRIED / carrying.TASK, self.folder / device / "runs"]
        files = [path for place in places for path in sorted(place.rglob("*")) if path.is_file()]
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture
def road(tmp_path: Path):
    road = Road(tmp_path)
    yield road
    road.store.close()


def test_a_device_without_any_connection_joins_works_and_delivers(road: Road) -> None:
    road.task()  # before it joined: a task is the edge's to sign
    assert "offline" in node_packs.unpack(road.folder / "d", road.disk)[0]
    performer = road.work()
    assert {name: (road.folder / "place" / name).read_text() for name in TASK} == dict.fromkeys(TASK, "{}")
    node_packs.pack(road.folder / "d", None, road.disk)
    said = node_packs.unpack(road.folder / "north", road.disk)
    assert said[0] == "devices/d has joined." and "is received" in said[1] and performer.begun == 1
    assert road.state() == "received" and road.store.is_carried(road.digests["d"])
    road.hub.install(road.digests["d"])
    assert (road.folder / "asked" / "d" / MODEL_NAME).read_bytes() == (road.folder / "model" / MODEL_NAME).read_bytes()


def test_the_commands_do_it_and_say_what_comes_next(road: Road, monkeypatch: pytest.MonkeyPatch) -> None:
    def say(*words: str) -> str:
        result = CliRunner().invoke(app, ["node", *words])
        assert result.exit_code == 0, (words, result.output)
        return result.output

    disk, north, device = (str(each) for each in (road.disk, road.folder / "north", road.folder / "d"))
    assert "task of devices/d" in say("pack", "d", "--out", disk, "--home", north)
    assert "--offline" in say("unpack", disk, "--home", device)
    (road.folder / "photos").mkdir()
    monkeypatch.setattr("radiant_app.network.device.DevicePerformer", lambda **given: Performer(road.folder))
    assert "radiant node pack" in say("work", "--photos", str(road.folder / "photos"), "--offline", "--yes", "--home", device)
    assert "result of devices/d" in say("pack", "--out", disk, "--home", device)
    assert "received" in say("unpack", disk, "--home", north)


def test_the_same_pack_again_changes_nothing(road: Road) -> None:
    road.result()
    node_packs.unpack(road.folder / "north", road.disk)
    before = road.kept()
    assert "is received" in node_packs.unpack(road.folder / "north", road.disk)[-1]
    road.hub.install(road.digests["d"])
    road.hub.accept(road.digests["d"])
    assert "is accepted" in node_packs.unpack(road.folder / "north", road.disk)[-1]
    assert before and road.kept().keys() & before.keys() == {path for path in before if "/d/" in path}


def altered_list(road: Road) -> None:
    text = (road.disk / packs.LIST_NAME).read_bytes()
    (road.disk / packs.LIST_NAME).write_bytes(text.replace(b'"attempt":1', b'"attempt":2'))


def other_bytes(road: Road) -> None:
    path = road.disk / packs.FILES / MODEL_NAME
    data = bytearray(path.read_bytes())
    data[1234] ^= 1
    path.write_bytes(data)


def shorter(road: Road) -> None:
    with (road.disk / packs.FILES / MODEL_NAME).open("r+b") as file:
        file.truncate(SIZE - 1)


def no_model(road: Road) -> None:
    (road.disk / packs.FILES / MODEL_NAME).unlink()


def a_link(road: Road) -> None:
    no_model(road)
    (road.disk / packs.FILES / MODEL_NAME).symlink_to(road.folder / "model" / MODEL_NAME)


def no_signature(road: Road) -> None:
    (road.disk / packs.SIGNATURE_NAME).unlink()


def long_signature(road: Road) -> None:
    with (road.disk / packs.SIGNATURE_NAME).open("ab") as file:
        file.write(bytes(10_000))


def signed_by_another(road: Road) -> None:
    stranger = make_home(road.folder / "stranger", None)
    envelope = packs.open_pack(road.disk, [open_home(road.folder / "d").key.public_key()]).envelope
    _, signature = carrying.sign_envelope(envelope, stranger.key)
    (road.disk / packs.SIGNATURE_NAME).write_bytes(signature)


def revoked(road: Road) -> None:
    commands.revoke(road.folder / "north", "d")


def nobody_waits(road: Road) -> None:
    road.hub.withdraw(road.digests["d"], "it was planned anew")


def replaced(road: Road) -> None:
    road.ask(text='{"other": 1}')


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (altered_list, "signed by nobody who is known here"),
        (other_bytes, "other bytes than its sender signed"),
        (shorter, "is no file of 300,000 bytes"),
        (no_model, "is missing"),
        (a_link, "is no file of 300,000 bytes"),
        (no_signature, "is refused|no signed list"),
        (long_signature, "expected at most 64"),
        (signed_by_another, "signed by nobody who is known here"),
        (revoked, "signed by nobody who is known here"),
        (nobody_waits, "withdrawn: it was planned anew"),
        (replaced, "withdrawn"),
    ],
)
def test_a_result_that_is_not_what_was_sent_or_not_awaited_is_refused(road: Road, spoil: Callable[[Road], None], reason: str) -> None:
    road.result()
    (road.disk / packs.JOIN_NAME).unlink()
    spoil(road)
    before = road.kept()
    with pytest.raises(RadiantError, match=reason):
        node_packs.unpack(road.folder / "north", road.disk)
    assert road.kept() == before and road.state() != "received"


def test_another_result_after_one_was_received_is_refused(road: Road) -> None:
    road.result()
    node_packs.unpack(road.folder / "north", road.disk)
    write_model(road.folder / "model", SIZE, 2)
    road.work()
    node_packs.pack(road.folder / "d", None, road.disk)
    with pytest.raises(BadInput, match="another result of this task was received first"):
        node_packs.unpack(road.folder / "north", road.disk)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda road: (road.disk / packs.FILES / "task.json").write_text("[]"), "other bytes"),
        (lambda road: (road.disk / packs.FILES / "task.json").write_text("{"), "is no file of 2 bytes"),
        (no_signature, "no signed list"),
        (altered_list, "signed by nobody"),
        (lambda road: shutil.rmtree(road.disk), "no folder"),
    ],
)
def test_a_task_that_is_not_what_was_sent_is_refused(road: Road, spoil: Callable[[Road], None], reason: str) -> None:
    road.task()
    spoil(road)
    with pytest.raises(BadInput, match=reason):
        node_packs.unpack(road.folder / "d", road.disk)
    assert road.kept() == {}


def test_a_task_of_another_device_or_an_older_one_is_refused(tmp_path: Path) -> None:
    road = Road(tmp_path, ("d", "c"))
    road.task("c")
    with pytest.raises(BadInput, match=r"for devices/c, expected one from edges/north for devices/d"):
        node_packs.unpack(tmp_path / "d", road.disk)
    road.task("d")
    shutil.copytree(road.disk, tmp_path / "older")
    road.ask(text='{"other": 1}')
    road.task("d")
    node_packs.unpack(tmp_path / "d", road.disk)
    road.work("d")
    with pytest.raises(BadInput, match="attempt 1, and attempt 2 was taken before"):
        node_packs.unpack(tmp_path / "d", tmp_path / "older")
    road.store.close()


def test_a_file_that_changes_while_it_is_copied_is_not_kept(road: Road, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that answers otherwise the second time: what was checked is not what is read."""
    road.task()
    monkeypatch.setattr(packs.Pack, "check", lambda pack: None)
    (road.disk / packs.FILES / "task.json").write_text("[]")
    with pytest.raises(BadInput, match="it changed meanwhile"):
        node_packs.unpack(road.folder / "d", road.disk)
    assert not any(path.endswith("task.json") for path in road.kept())
    with pytest.raises(BadInput, match="no task was unpacked"):
        road.work()


def test_a_result_whose_bytes_change_under_the_check_is_not_received(road: Road, monkeypatch: pytest.MonkeyPatch) -> None:
    road.result()
    monkeypatch.setattr(packs.Pack, "check", lambda pack: None)
    other_bytes(road)
    with pytest.raises(BadInput, match="changed while it was read"):
        node_packs.unpack(road.folder / "north", road.disk)
    assert road.state() != "received"


def test_work_that_fails_says_why_and_leaves_no_result(road: Road) -> None:
    road.task()
    node_packs.unpack(road.folder / "d", road.disk)
    with pytest.raises(StageFailed, match="no photograph has a position"):
        road.work(error=StageFailed("no photograph has a position."))
    assert not (road.folder / "d" / carrying.CARRIED / carrying.RESULT_NAME).exists()


def test_a_full_disk_is_said_before_a_byte(road: Road, monkeypatch: pytest.MonkeyPatch) -> None:
    road.result()
    before = road.kept()
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: type("Usage", (), {"free": SPARE_BYTES})())
    with pytest.raises(CannotWrite, match="is full"):
        node_packs.unpack(road.folder / "north", road.disk)
    assert road.kept() == before
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: type("Usage", (), {"free": 1000})())
    with pytest.raises(CannotWrite, match="1,000 bytes free"):
        node_packs.pack(road.folder / "d", None, road.disk)


def test_a_folder_with_something_else_is_left_as_it_is(road: Road) -> None:
    road.disk.mkdir()
    (road.disk / "holiday.jpg").write_bytes(b"x")
    with pytest.raises(BadInput, match=r"holds 'holiday.jpg'"):
        road.task()
    assert [path.name for path in road.disk.iterdir()] == ["holiday.jpg"]


def _files_is_a_link(road: Road) -> None:
    (road.folder / "holiday").mkdir()
    (road.folder / "holiday" / "a.jpg").write_bytes(b"x")
    (road.disk / packs.FILES).symlink_to(road.folder / "holiday")


def _files_leads_nowhere(road: Road) -> None:
    (road.disk / packs.FILES).symlink_to(road.folder / "nowhere")


def _files_is_a_file(road: Road) -> None:
    (road.disk / packs.FILES).write_bytes(b"x")


@pytest.mark.parametrize("odd", [_files_is_a_link, _files_leads_nowhere, _files_is_a_file])
def test_a_folder_whose_files_are_no_folder_is_left_as_it_is(road: Road, odd: Callable[[Road], None]) -> None:
    """Neither emptied nor written to: a link would lead to another place."""
    road.disk.mkdir()
    odd(road)
    with pytest.raises(BadInput, match=r"holds 'files', which is no folder of a pack: give a folder that is new, empty, or an earlier"):
        road.task()
    assert [path.name for path in road.disk.iterdir()] == [packs.FILES]
    assert not (road.folder / "nowhere").exists() and all(path.exists() for path in (road.folder / "holiday").glob("*"))


def test_what_is_not_there_any_more_is_said_by_its_name(road: Road) -> None:
    road.result()
    (road.folder / "model" / MODEL_NAME).unlink()
    with pytest.raises(BadInput, match=rf"model/{MODEL_NAME} is not there any more: run again what makes it, then pack it"):
        node_packs.pack(road.folder / "d", None, road.disk)
    with pytest.raises(BadInput, match="no signed list"):
        packs.open_pack(road.disk, [])


def swapped_files(road: Road) -> None:
    shutil.rmtree(road.disk / packs.FILES)
    shutil.copytree(road.folder / "of d" / packs.FILES, road.disk / packs.FILES)


def swapped_list(road: Road) -> None:
    shutil.copyfile(road.folder / "of d" / packs.LIST_NAME, road.disk / packs.LIST_NAME)


def swapped_signature(road: Road) -> None:
    shutil.copyfile(road.folder / "of d" / packs.SIGNATURE_NAME, road.disk / packs.SIGNATURE_NAME)


def cut_list(road: Road) -> None:
    text = (road.disk / packs.LIST_NAME).read_bytes()
    (road.disk / packs.LIST_NAME).write_bytes(text[:-40])


@pytest.mark.parametrize(
    ("swap", "reason"),
    [
        (swapped_files, "other bytes than its sender signed"),
        (swapped_list, "signed by nobody who is known here"),
        (swapped_signature, "signed by nobody who is known here"),
        (cut_list, "signed by nobody who is known here"),
    ],
)
def test_packs_of_two_devices_that_were_mixed_are_refused(tmp_path: Path, swap: Callable[[Road], None], reason: str) -> None:
    road = Road(tmp_path, ("d", "c"))
    road.result("d")
    shutil.copytree(road.disk, road.folder / "of d")
    write_model(road.folder / "model", SIZE, 2)
    road.result("c")
    swap(road)
    with pytest.raises(BadInput, match=reason):
        node_packs.unpack(road.folder / "north", road.disk)
    assert {road.state("d"), road.state("c")} == {"offered"}
    road.store.close()


@pytest.mark.parametrize("reader", ["another edge", "the device itself", "the edge that packed it"])
def test_a_pack_at_a_machine_that_it_is_not_for_is_refused(tmp_path: Path, reader: str) -> None:
    road, other = Road(tmp_path / "a"), Road(tmp_path / "b")
    road.result()
    if reader == "the edge that packed it":
        road.task()
    place = {"another edge": other.folder / "north", "the device itself": road.folder / "d"}.get(reader, road.folder / "north")
    with pytest.raises(BadInput, match="signed by nobody who is known here"):
        node_packs.unpack(place, road.disk)
    assert road.state() != "received" and other.state() == "offered"
    road.store.close()
    other.store.close()


@pytest.mark.parametrize("name", ["../x", "/x", "a/../../x", ".x", "a//x", "a\\x", "x\0"])
def test_a_member_that_signs_a_name_which_leaves_the_folder_is_refused(road: Road, name: str) -> None:
    road.result()
    record = json.loads((road.disk / packs.LIST_NAME).read_bytes())
    record["files"][name] = record["files"].pop(MODEL_NAME)
    text = json.dumps(record, sort_keys=True, separators=(",", ":")).encode()
    (road.disk / packs.LIST_NAME).write_bytes(text)
    (road.disk / packs.SIGNATURE_NAME).write_bytes(open_home(road.folder / "d").key.sign(b"radiant.envelope 1\0" + text))
    with pytest.raises(BadInput, match="expected a name inside the folder"):
        node_packs.unpack(road.folder / "north", road.disk)
    assert road.state() != "received" and not (road.folder / "x").exists()


def test_a_disk_that_fills_while_a_pack_is_written_leaves_no_pack(road: Road) -> None:
    """The system refuses in the middle of the model, as a full disk does; an earlier pack there is none any more."""
    road.result()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (SIZE // 2, limits[1]))
    try:
        with pytest.raises(CannotWrite, match=rf"cannot write .*{MODEL_NAME}: File too large"):
            node_packs.pack(road.folder / "d", None, road.disk)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not (road.disk / packs.FILES / MODEL_NAME).exists()
    with pytest.raises(BadInput, match="no signed list"):
        packs.open_pack(road.disk, [])
    node_packs.pack(road.folder / "d", None, road.disk)
    assert "is received" in node_packs.unpack(road.folder / "north", road.disk)[-1]


@pytest.mark.parametrize("command", ["unpack", "pack", "invite", "revoke"])
def test_a_database_that_cannot_be_written_ends_in_a_sentence(road: Road, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As SQLite says it on a disk without room."""
    road.result()
    before = road.kept()

    def full(*given: object, **more: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    for name in ("put_result", "open_task", "invite", "revoke"):
        monkeypatch.setattr(HubStore, name, full)
    north = road.folder / "north"
    actions: dict[str, Callable[[], object]] = {
        "unpack": lambda: node_packs.unpack(north, road.disk),
        "pack": lambda: node_packs.pack(north, "d", road.folder / "other"),
        "invite": lambda: commands.invite(north, "c", road.folder / "c.join"),
        "revoke": lambda: commands.revoke(north, "d"),
    }
    with pytest.raises(
        CannotWrite, match=r"hub\.sqlite cannot be used \(database or disk is full\): free space on its disk, then do it again"
    ):
        actions[command]()
    assert road.kept() == before and not (road.folder / "c.join").exists()


def test_a_forged_request_to_join_is_refused(road: Road) -> None:
    node_packs.pack(road.folder / "d", None, road.disk)
    path = road.disk / packs.JOIN_NAME
    record = json.loads(path.read_text())
    other = make_home(road.folder / "other", None)
    shutil.copyfile(road.folder / "d" / "upper.json", other.folder / "upper.json")
    _, stolen = carrying.sealed_join(open_home(other.folder))
    packs.write_join(road.disk, record["headers"], stolen)
    with pytest.raises(BadInput, match="another body than was sealed"):
        node_packs.unpack(road.folder / "north", road.disk)
    member = road.store.member("devices/d")
    assert member is not None and member.key is None


STEPS = st.lists(
    st.one_of(
        st.sampled_from(["task", "unpack task", "work", "pack", "unpack", "withdraw", "offer", "lose the disk"]),
        st.tuples(st.just("spoil"), st.integers(0, 10**6), st.integers(1, 255)),
    ),
    max_size=12,
)


def _spoil(road: Road, at: int, by: int) -> None:
    """Another byte somewhere on the disk."""
    files = sorted(path for path in road.disk.rglob("*") if path.is_file())
    if files:
        path = files[at % len(files)]
        data = bytearray(path.read_bytes())
        if data:
            data[at % len(data)] ^= by
            path.write_bytes(data)


@settings(max_examples=25, deadline=None)
@given(steps=STEPS)
def test_any_order_gives_the_same_bytes_or_a_refusal(steps: list) -> None:
    with memory_folder() as folder:
        road = Road(folder)
        actions: dict[str, Callable[[], object]] = {
            "task": road.task,
            "unpack task": lambda: node_packs.unpack(folder / "d", road.disk),
            "work": road.work,
            "pack": lambda: node_packs.pack(folder / "d", None, road.disk),
            "unpack": lambda: node_packs.unpack(folder / "north", road.disk),
            "withdraw": lambda: road.hub.withdraw(road.digests["d"]),
            "offer": road.ask,
            "lose the disk": lambda: shutil.rmtree(road.disk, ignore_errors=True),
        }
        try:
            for step in [*steps, "lose the disk", "offer", "task", "unpack task", "work", "pack", "unpack"]:
                if road.state() == "received":
                    break
                if isinstance(step, tuple):
                    _spoil(road, *step[1:])
                    continue
                try:
                    actions[step]()
                except RadiantError:
                    assert step in {*actions} - {"withdraw", "offer", "lose the disk"}
            assert road.state() == "received"
            road.hub.install(road.digests["d"])
            assert (folder / "asked" / "d" / MODEL_NAME).read_bytes() == (folder / "model" / MODEL_NAME).read_bytes()
        finally:
            road.store.close()


def test_an_edge_hands_its_tasks_to_those_that_it_invited_alone(road: Road) -> None:
    with pytest.raises(BadInput, match="devices/x has nothing to do now"):
        node_packs.pack(road.folder / "north", "x", road.disk)
    with pytest.raises(BadInput, match="nobody has joined devices/d"):
        node_packs.pack(road.folder / "d", "x", road.disk)


def an_own_task(road: Road) -> None:
    """The edge's own list, handed back as if it were a result."""
    shutil.rmtree(road.disk)
    road.task()


def sign_again(road: Road, **changes: str) -> None:
    """The list of a result with other values, signed by the device as its own."""
    home = open_home(road.folder / "d")
    envelope = packs.open_pack(road.disk, [home.key.public_key()]).envelope
    text, signature = carrying.sign_envelope(replace(envelope, **changes), home.key)
    (road.disk / packs.LIST_NAME).write_bytes(text)
    (road.disk / packs.SIGNATURE_NAME).write_bytes(signature)


def of_another_run(road: Road) -> None:
    """What the same device made for an earlier run, with its signature."""
    sign_again(road, run="1" * 32, answers=hashlib.sha256(b"a task of then").hexdigest())


def of_another_stage(road: Road) -> None:
    """An honest list in which the stage is that of another round."""
    sign_again(road, kind="refine", stage="devices/d/refine2")


def in_the_name_of_another(road: Road) -> None:
    """Signed by a member that joined, as the sender it is not."""
    sign_again(road, sender="devices/c", stage="devices/c")


def files_of_another_pack(road: Road) -> None:
    """A whole pack whose files are those of another whole pack of as many bytes."""
    write_model(road.folder / "model", SIZE, 3)
    shutil.copyfile(road.folder / "model" / MODEL_NAME, road.disk / packs.FILES / MODEL_NAME)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (an_own_task, "signed by nobody who is known here"),
        (of_another_run, "devices/d has no such task"),
        (of_another_stage, "is refused"),
        (in_the_name_of_another, "is said to be of devices/c, whose key did not sign it"),
        (files_of_another_pack, "other bytes than its sender signed"),
    ],
)
def test_a_pack_that_is_swapped_or_foreign_is_refused(road: Road, spoil: Callable[[Road], None], reason: str) -> None:
    road.result()
    spoil(road)
    (road.disk / packs.JOIN_NAME).unlink(missing_ok=True)
    before = road.kept()
    with pytest.raises(BadInput, match=reason):
        node_packs.unpack(road.folder / "north", road.disk)
    assert road.kept() == before and road.state() != "received"


def test_a_request_to_join_of_an_old_disk_lets_nobody_in_again(road: Road) -> None:
    road.join()
    old = (road.disk / packs.JOIN_NAME).read_bytes()
    commands.revoke(road.folder / "north", "d")
    for _ in range(2):
        (road.disk / packs.JOIN_NAME).write_bytes(old)
        with pytest.raises(BadInput, match="the request to join is refused: "):
            node_packs.unpack(road.folder / "north", road.disk)
        commands.invite(road.folder / "north", "d", road.folder / "again.join")
    member = road.store.member("devices/d")
    assert member is not None and member.key is None


def test_the_task_of_an_earlier_round_on_an_old_disk_changes_nothing(road: Road) -> None:
    road.result()
    node_packs.unpack(road.folder / "north", road.disk)
    road.hub.install(road.digests["d"])
    road.hub.accept(road.digests["d"])
    shutil.copytree(road.disk, road.folder / "old")
    road.ask(text='{"round": 2}')
    assert "is accepted" in node_packs.unpack(road.folder / "north", road.folder / "old")[-1], "that of then, once more"
    task = road.store.open_task("devices/d")
    assert task is not None and task.state == "offered", "the new one waits for its own result"
