"""Who a node is and whose uploads it takes: an honest sender's alone, in its own run, once registered; every other is told why."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from radiant_app.workers.delivering import deliver, exchange_keys, find_refusals, run_number, sign_upload
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.delivery import MAX_ATTEMPT
from radiant_core.io.transport.signing import KEY_NAME, PUBLIC_NAME

EDGE = "edges/north"


def made_run(folder: Path) -> Path:
    """A run of an edge with devices a and b, all introduced, from above."""
    devices = ["devices/a", "devices/b"]
    exchange_keys(folder, "cloud", None, [EDGE])
    exchange_keys(folder, EDGE, "cloud", devices)
    for device in devices:
        exchange_keys(folder, device, EDGE)
    return folder


def sent(run: Path, sender: str, *names: str) -> list[str]:
    """Sign files of a sender's folder, made of its name."""
    for name in names:
        (run / sender / name).write_text(f"{sender} {name}")
    return deliver(run / sender, {name: run / sender / name for name in names})


def arrived(run: Path, sender: str, receiver: str, name: str = "") -> None:
    """Copy what a sender signed to its receiver as the upload of `name`, itself where none is given."""
    name = name or Path(sender).name
    for place in ("inbox", "deliveries"):
        (run / receiver / place / name).mkdir(parents=True, exist_ok=True)
    for path in (run / sender).glob("*.safetensors"):
        shutil.copyfile(path, run / receiver / "inbox" / name / path.name)
    for path in (run / sender).glob("delivery.*"):
        shutil.copyfile(path, run / receiver / "deliveries" / name / path.name)


def refused(run: Path, receiver: str = EDGE, *senders: str) -> dict[str, str]:
    names = senders or ("a", "b")
    return find_refusals(run / receiver, names, {name: run / receiver / "inbox" / name for name in names})


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run in which both devices have delivered to their edge."""
    made_run(tmp_path / "run")
    for name in ("a", "b"):
        sent(tmp_path / "run", f"devices/{name}", "model.safetensors", "cameras.safetensors")
        arrived(tmp_path / "run", f"devices/{name}", EDGE)
    return tmp_path / "run"


def test_a_run_has_one_number_and_another_run_another(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    number = run_number(tmp_path / "one")
    assert re.fullmatch("[0-9a-f]{32}", number) and run_number(tmp_path / "one") == number != run_number(tmp_path / "two")


def test_a_node_learns_who_it_is_and_only_its_public_key_leaves_it(tmp_path: Path) -> None:
    run = made_run(tmp_path)
    assert read_json(run / "devices/a/identity/post.json") == {"run": run_number(run), "node": "devices/a", "receiver": EDGE}
    assert (run / "devices/a/identity").stat().st_mode & 0o777 == 0o700
    registered = run / EDGE / "senders"
    assert sorted(path.name for path in registered.iterdir()) == ["a.pub", "b.pub"]
    assert (registered / "a.pub").read_bytes() == (run / "devices/a/identity" / PUBLIC_NAME).read_bytes()
    assert [path.name for path in (run / "cloud/senders").iterdir()] == ["north.pub"]
    # The other way it is the key of the one above, whose tasks it takes; above the cloud is nobody.
    assert (run / "devices/a/identity/above.pub").read_bytes() == (run / EDGE / "identity" / PUBLIC_NAME).read_bytes()
    assert not (run / "cloud/identity/above.pub").exists()
    private = [path for path in run.rglob("*.pem") if path.parent.name != "identity"]
    assert private == [], "no private key outside of its owner's identity"


def test_introduced_again_keys_stay_and_a_changed_registration_is_not_healed(run: Path) -> None:
    key = (run / "devices/a/identity" / KEY_NAME).read_bytes()
    made_run(run)
    assert (run / "devices/a/identity" / KEY_NAME).read_bytes() == key and refused(run) == {}
    shutil.copyfile(run / EDGE / "senders/b.pub", run / EDGE / "senders/a.pub")
    made_run(run)
    assert list(refused(run)) == ["a"] and "not signed by the key that is registered" in refused(run)["a"]
    assert refused(run)["a"].endswith("If the folder devices/a was put here from another run, remove it and go on with --resume.")
    # Where the registration is gone it is made again.
    (run / EDGE / "senders/a.pub").unlink()
    assert list(refused(run)) == ["a"]
    made_run(run)
    assert refused(run) == {}


def test_a_node_that_lost_its_key_gets_one_that_is_registered_and_has_to_sign_again(run: Path) -> None:
    later = [run / "devices/a/refine/delivery.sig", run / "devices/a/score/delivery.sig"]
    for signature in later:
        signature.parent.mkdir()
        signature.touch()
    (run / "devices/a/identity" / KEY_NAME).unlink()
    made_run(run)
    assert not (run / "devices/a/delivery.sig").exists() and (run / "devices/b/delivery.sig").exists()
    assert not any(signature.exists() for signature in later), "what it refined and scored was signed by the older key"
    assert list(refused(run)) == ["a"]
    sent(run, "devices/a", "model.safetensors", "cameras.safetensors")
    arrived(run, "devices/a", EDGE)
    assert refused(run) == {}


def test_every_delivery_is_the_attempt_after_the_last(run: Path) -> None:
    record = run / "devices/a/delivery.json"
    assert read_json(record)["attempt"] == 1
    for last, attempt in ((None, 2), (41, 42), (0, 1), (-5, 1), ("7", 1), (True, 1), (MAX_ATTEMPT - 1, MAX_ATTEMPT)):
        if last is not None:
            write_json(record, {"attempt": last})
        assert sent(run, "devices/a", "model.safetensors", "cameras.safetensors") == ["delivery.json", "delivery.sig"]
        assert read_json(record)["attempt"] == attempt, last
    record.write_text("{")
    sent(run, "devices/a", "model.safetensors", "cameras.safetensors")
    assert read_json(record)["attempt"] == 1


def test_honest_uploads_are_taken_on_both_tiers(run: Path) -> None:
    assert refused(run) == {}
    sent(run, EDGE, "model.safetensors")
    arrived(run, EDGE, "cloud")
    assert refused(run, "cloud", "north") == {}
    kinds = {node: read_json(run / node / "delivery.json")["kind"] for node in (EDGE, "devices/a")}
    assert kinds == {EDGE: "edge_model", "devices/a": "device_model"}


def signed_as(**changed: str) -> Callable[[Path], None]:
    """Device a signs and sends its upload as somebody else, for somebody else, or in another run."""

    def wrong(run: Path) -> None:
        post = run / "devices/a/identity/post.json"
        write_json(post, {**read_json(post), **changed})
        is_edge = changed.get("node", "").startswith("edges")
        sent(run, "devices/a", "model.safetensors", *([] if is_edge else ["cameras.safetensors"]))
        arrived(run, "devices/a", EDGE)

    return wrong


def changed_on_its_way(run: Path) -> None:
    path = run / EDGE / "inbox/a/model.safetensors"
    path.write_bytes(path.read_bytes()[:-1] + b"x")


def without_signature(run: Path) -> None:
    (run / EDGE / "deliveries/a/delivery.sig").unlink()


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (signed_as(run="f" * 32), f"belongs to run '{'f' * 32}'"),
        (signed_as(run="f" * 32), "If the folder devices/a was put here from another run, remove it and go on with --resume."),
        (signed_as(receiver="edges/south"), "is addressed to 'edges/south', this is 'edges/north'"),
        (signed_as(node="devices/b"), "'devices/b' sends region 'a', which 'devices/a' is to deliver"),
        (signed_as(node="edges/a"), "it sent 'edge_model', expected 'device_model'"),
        (changed_on_its_way, "has other bytes than its sender signed"),
        (without_signature, "delivery.sig"),
    ],
)
def test_a_wrong_upload_is_refused_with_its_reason_and_harms_no_other(run: Path, wrong: Callable[[Path], None], reason: str) -> None:
    wrong(run)
    found = refused(run)
    assert list(found) == ["a"] and reason in found["a"]


def test_what_goes_up_is_the_model_in_its_upload_format_with_its_cameras_and_an_uncertain_frame(run: Path) -> None:
    folder = run / "devices/a"
    exact, uncertain = ({"status": "placed", "reason": "", "uncertainty": found} for found in (None, {"position_m": 1.0}))
    for frame, expected in ((exact, []), (uncertain, ["frame.json"])):
        (folder / "upload.safetensors").unlink(missing_ok=True)
        write_json(folder / "frame.json", frame)
        for upload, source in (("float32", "model.safetensors"), ("spz", "upload.safetensors"), ("float16", "upload.safetensors")):
            (folder / source).write_text(f"{upload} bytes")
            assert sign_upload(folder) == ["delivery.json", "delivery.sig"]
            files = read_json(folder / "delivery.json")["files"]
            assert sorted(files) == ["cameras.safetensors", *expected, "model.safetensors"]
            assert files["model.safetensors"]["bytes"] == len(f"{upload} bytes")


def test_a_folder_that_is_no_runs_sends_nothing_signed(run: Path) -> None:
    shutil.rmtree(run / "devices/a" / "identity")
    assert sign_upload(run / "devices/a") == []
