"""The run store: a file is the old or the new one, and a seal notices every changed bit."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.run_store import (
    RunLock,
    atomic_writer,
    content_key,
    file_sha256,
    is_sealed,
    read_json,
    seal,
    seal_problem,
    write_atomic,
    write_json,
)


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_writing_replaces_the_whole_file_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_atomic(path, b"long old content")
    write_atomic(path, b"new")
    assert path.read_bytes() == b"new"
    assert names_in(tmp_path) == {"a.bin"}


@pytest.mark.parametrize("failing", ["fsync", "replace"])
def test_a_full_disk_leaves_the_old_file_and_no_temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str) -> None:
    path = tmp_path / "a.bin"
    write_atomic(path, b"old")

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(*((os, "fsync") if failing == "fsync" else (Path, "replace")), refuse)
    with pytest.raises(BadInput, match=r"cannot write .*a\.bin: No space left on device: free space"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert names_in(tmp_path) == {"a.bin"}


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES, errno.ENOSPC, errno.EDQUOT], ids=lambda code: errno.errorcode[code])
def test_free_space_is_asked_for_only_where_there_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def refuse(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(BadInput) as told:
        write_atomic(tmp_path / "a.bin", b"new")
    is_full = code in (errno.ENOSPC, errno.EDQUOT)
    way = "free space or choose another output folder" if is_full else "choose another folder that may be written"
    assert str(told.value) == f"cannot write {tmp_path / 'a.bin'}: {os.strerror(code)}: {way}."


def test_a_file_size_limit_of_the_system_leaves_the_old_file(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.bin", b"old")
    code = (
        "import resource, signal, sys; from pathlib import Path; from radiant_core.io.run_store import write_atomic\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n    write_atomic(Path(sys.argv[1]), bytes(100_000))\nexcept ValueError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.bin")], capture_output=True, text=True, check=True)
    assert "File too large" in done.stdout
    assert (tmp_path / "a.bin").read_bytes() == b"old"
    assert names_in(tmp_path) == {"a.bin"}


def test_a_writer_that_fails_midway_leaves_the_old_file(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.bin", b"old")

    def write_half() -> None:
        with atomic_writer(tmp_path / "a.bin") as file:
            file.write(b"half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert (tmp_path / "a.bin").read_bytes() == b"old"
    assert names_in(tmp_path) == {"a.bin"}


def test_killed_writers_leave_the_old_or_the_new_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_atomic(path, b"\0" * 2_000_000)
    code = (
        "import sys; from pathlib import Path; from radiant_core.io.run_store import write_atomic\n"
        "print('ready', flush=True)\n"
        "while True:\n    for value in range(256): write_atomic(Path(sys.argv[1]), bytes([value]) * 2_000_000)"
    )
    for wait_ms in (3, 11, 17, 29):
        with subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            with pytest.raises(subprocess.TimeoutExpired):
                writer.wait(wait_ms / 1000)
            writer.send_signal(signal.SIGKILL)
        data = path.read_bytes()
        assert len(data) == 2_000_000
        assert len(set(data)) == 1


def test_a_missing_folder_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="No such file or directory"):
        write_atomic(tmp_path / "absent" / "a.bin", b"")


def test_json_comes_back_with_every_bit_of_its_floats(tmp_path: Path) -> None:
    value = {"b": [1.1, -0.0, 5e-324, 1.7976931348623157e308, 2**70], "a": {"ö": None, "t": True}}
    write_json(tmp_path / "a.json", value)
    assert read_json(tmp_path / "a.json") == value
    assert (tmp_path / "a.json").read_text().index('"a"') < (tmp_path / "a.json").read_text().index('"b"')


@pytest.mark.parametrize("value", [float("nan"), [float("inf")], {"a": object()}, {1, 2}, {("a",): 1}])
def test_json_refuses_what_it_cannot_keep(tmp_path: Path, value: Any) -> None:
    with pytest.raises(BadInput, match="as JSON"):
        write_json(tmp_path / "a.json", value)
    assert names_in(tmp_path) == set()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"NaN",
        b"[1e999]",
        b"[-Infinity]",
        b'{"a":1,"a":2}',
        b"\xff\xfe\xff",
        b"[" * 2000,
        b"1" * 5000,
        b'{"a": 1} x',
        # Half a character, in its escape, its bytes and in 16 bits: no file of ours could hold it.
        b'["\\ud800"]',
        b'{"\\uDFFF": 1}',
        b'["\\ude00\\ud83d"]',
        b'["\xed\xa0\x80"]',
        '["\ud800"]'.encode("utf-16-le", errors="surrogatepass"),
    ],
)
def test_poisoned_json_is_store_damaged(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.json").write_bytes(data)
    with pytest.raises(StoreDamaged, match=r"a\.json is not valid JSON"):
        read_json(tmp_path / "a.json")


@pytest.mark.parametrize("text", ["\U0001f600", "\ud7ff", "\ue000", "\\ud800", "a\0b"])
def test_whole_characters_are_read_however_they_are_written(tmp_path: Path, text: str) -> None:
    for data in (json.dumps([text]).encode(), json.dumps([text], ensure_ascii=False).encode(), json.dumps([text]).encode("utf-16")):
        (tmp_path / "a.json").write_bytes(data)
        assert read_json(tmp_path / "a.json") == [text]
    write_json(tmp_path / "a.json", [text])


def test_reading_is_bounded_and_never_waits(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"[" + b"1," * 1000 + b"1]")
    with pytest.raises(StoreDamaged, match="expected at most 100"):
        read_json(tmp_path / "a.json", max_bytes=100)
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", "absent.json", ""):
        with pytest.raises(StoreDamaged):
            read_json(tmp_path / name)
        with pytest.raises(StoreDamaged):
            file_sha256(tmp_path / name)


def test_sha256_is_that_of_the_standard(tmp_path: Path) -> None:
    (tmp_path / "abc").write_bytes(b"abc")
    # FIPS 180-4, example B.1.
    assert file_sha256(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


@dataclass(frozen=True)
class Config:
    steps: int
    rate: float


def different_values(folder: Path) -> Iterator[Any]:
    (folder / "a").write_bytes(b"1")
    (folder / "b").write_bytes(b"2")
    yield from [None, True, False, 0, 1, 0.0, -0.0, 1.0, "", "1", b"1", [], [[]], ["", ""], ["a", "b"], ["ab"], [["a"], "b"]]
    yield from [{}, {"a": 1}, {"b": 1}, {"a": {"b": 1}}, {"a": [1]}, Config(1, 0.5), Config(1, 0.25), Config(2, 0.5)]
    yield from [np.zeros(2), np.zeros(2, np.float32), np.zeros((2, 1)), np.zeros((1, 2)), np.ones(2), np.zeros(4, np.int32)]
    yield from [folder / "a", folder / "b", folder]


def test_content_keys_differ_for_different_values(tmp_path: Path) -> None:
    values = list(different_values(tmp_path))
    assert len({content_key(value) for value in values}) == len(values)
    assert content_key("a", "b") != content_key("ab")


def test_content_keys_are_equal_for_equal_values(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"same")
    (tmp_path / "y").write_bytes(b"same")
    assert content_key(tmp_path / "x") == content_key(tmp_path / "y")
    assert content_key({"a": 1, "b": 2}) == content_key({"b": 2, "a": 1})
    assert content_key((1, 2)) == content_key([1, 2])
    assert content_key(np.float64(1.5), np.int32(3)) == content_key(1.5, 3)
    strided = np.arange(12.0).reshape(3, 4).T
    assert content_key(strided) == content_key(strided.copy()) == content_key(strided.astype(">f8"))


def test_content_keys_are_the_same_in_another_process() -> None:
    code = "from radiant_core.io.run_store import content_key; print(content_key({'b': 1.5, 'a': ['x', None]}, 7))"
    environment = {**os.environ, "PYTHONHASHSEED": "123"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.strip() == content_key({"b": 1.5, "a": ["x", None]}, 7)


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array([object()]), {1: 2}])
def test_content_keys_refuse_what_has_no_stable_bytes(value: Any) -> None:
    with pytest.raises((TypeError, AttributeError)):
        content_key(value)


def sealed_folder(folder: Path) -> Path:
    (folder / "sub").mkdir()
    (folder / "model.bin").write_bytes(bytes(range(64)))
    (folder / "sub" / "b.txt").write_bytes(b"two")
    seal(folder, "key-1", ["model.bin", "sub/b.txt"])
    return folder


def test_a_sealed_folder_is_sealed_under_its_key_only(tmp_path: Path) -> None:
    folder = sealed_folder(tmp_path)
    assert is_sealed(folder, "key-1")
    assert seal_problem(folder, "key-1") is None
    assert not is_sealed(folder, "key-2")
    assert "other inputs or settings" in str(seal_problem(folder, "key-2"))


def test_every_flipped_bit_of_a_file_breaks_the_seal(tmp_path: Path) -> None:
    folder = sealed_folder(tmp_path)
    good = (folder / "model.bin").read_bytes()
    for bit in range(8 * len(good)):
        damaged = bytearray(good)
        damaged[bit // 8] ^= 1 << bit % 8
        (folder / "model.bin").write_bytes(bytes(damaged))
        assert "model.bin is not what was written" in str(seal_problem(folder, "key-1"))
    (folder / "model.bin").write_bytes(good)
    assert is_sealed(folder, "key-1")


def test_every_damage_to_the_seal_itself_is_a_problem_and_no_exception(tmp_path: Path) -> None:
    folder = sealed_folder(tmp_path)
    good = (folder / "done.json").read_bytes()
    for at in range(len(good)):
        if good[at] in b" \n":  # white space says nothing
            continue
        for changed in (good[:at], good[:at] + b"\x07" + good[at + 1 :], good[:at] + b"x" + good[at:]):
            (folder / "done.json").write_bytes(changed)
            if changed.strip() != good.strip():
                assert not is_sealed(folder, "key-1"), changed


def test_a_missing_file_or_seal_is_named(tmp_path: Path) -> None:
    folder = sealed_folder(tmp_path)
    (folder / "sub" / "b.txt").unlink()
    assert "b.txt" in str(seal_problem(folder, "key-1"))
    (folder / "done.json").unlink()
    assert "there is no done.json" in str(seal_problem(folder, "key-1"))


@pytest.mark.parametrize("name", ["../out", "/etc/hostname", "", ".", "a/../../b", "\0", "\ud800"])
def test_a_seal_never_reaches_outside_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises((BadInput, StoreDamaged)):
        seal(tmp_path, "key", [name])
    (tmp_path / "done.json").write_text(json.dumps({"files": {name: "0"}, "key": "key", "version": 1}))
    assert not is_sealed(tmp_path, "key")


def test_a_second_process_cannot_lock_and_a_killed_one_frees_the_lock(tmp_path: Path) -> None:
    code = (
        "import sys, time; from radiant_core.io.run_store import RunLock\n"
        "with RunLock(sys.argv[1]): print('held', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(BadInput, match=f"another process \\({holder.pid}\\) is writing"), RunLock(tmp_path):
            pytest.fail("two writers at once")
        holder.kill()
    with RunLock(tmp_path):
        pass


def test_a_lock_can_be_taken_again_after_its_block(tmp_path: Path) -> None:
    for _ in range(2):
        with RunLock(tmp_path), pytest.raises(BadInput, match="another process"), RunLock(tmp_path):
            pytest.fail("two writers at once")


def test_a_folder_that_is_not_there_cannot_be_locked(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot lock"), RunLock(tmp_path / "absent"):
        pytest.fail("locked nothing")


def test_the_key_of_a_folder_is_that_of_the_names_and_bytes_of_its_files(tmp_path: Path) -> None:
    def made(name: str, **files: str) -> str:
        for path, text in files.items():
            place = tmp_path / name / path.replace("__", "/")
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text)
        return content_key(tmp_path / name)

    first = made("first", a="1", sub__b="2")
    assert made("same", sub__b="2", a="1") == first, "where it lies and which file came first does not matter"
    others = [made("bytes", a="1", sub__b="3"), made("name", a="1", sub__c="2"), made("place", a="1", b="2"), made("less", a="1")]
    assert len({first, *others}) == 5


def test_why_a_file_cannot_be_hashed_is_told_in_the_systems_words(tmp_path: Path) -> None:
    with pytest.raises(StoreDamaged, match=r"cannot read .*none: No such file or directory: run the stage"):
        file_sha256(tmp_path / "none")
    with pytest.raises(StoreDamaged, match="surrogates not allowed: run the stage"):
        file_sha256(tmp_path / "\ud800")
    with pytest.raises(StoreDamaged, match=r"is not a file: name the file itself|Is a directory"):
        file_sha256(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    for read in (file_sha256, read_json):
        with pytest.raises(StoreDamaged, match="pipe is not a file: name the file itself"):
            read(tmp_path / "pipe")


def test_json_ends_at_its_limit_and_has_its_keys(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('{"a": 1, "b": 2}')
    assert read_json(path, ["a", "b"], 16) == {"a": 1, "b": 2} == read_json(path, ["b"])
    with pytest.raises(StoreDamaged, match="has 16 bytes, expected at most 15: it is not a file of this kind"):
        read_json(path, max_bytes=15)
    with pytest.raises(StoreDamaged, match="is no JSON object with a, c"):
        read_json(path, ["a", "c"])
    path.write_text("[]")
    with pytest.raises(StoreDamaged, match="is no JSON object with a"):
        read_json(path, ["a"])
    for text, told in (
        ('{"a": 1, "a": 1}', "a key comes twice"),
        ("[1e999]", "the number 1e999 is not finite"),
        ("[NaN]", "the number NaN"),
        ("{", "JSON"),
    ):
        path.write_text(text)
        with pytest.raises(StoreDamaged, match=told):
            read_json(path)
    path.write_bytes(b" " * (64 * 2**20 - 2) + b"[]")
    assert read_json(path) == []
    path.write_bytes(b" " * (64 * 2**20 - 1) + b"[]")
    with pytest.raises(StoreDamaged, match="has 67108865 bytes, expected at most 67108864"):
        read_json(path)


def test_json_is_written_for_people_with_sorted_keys(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"b": ["ö"], "a": None})
    assert (tmp_path / "a.json").read_text() == '{\n "a": null,\n "b": [\n  "ö"\n ]\n}\n'
    for wrong in (float("nan"), {1, 2}, "\ud800"):
        with pytest.raises(BadInput, match=r"cannot write .*b\.json as JSON"):
            write_json(tmp_path / "b.json", wrong)
    assert names_in(tmp_path) == {"a.json"}


def test_a_seal_says_version_key_and_hashes(tmp_path: Path) -> None:
    folder = sealed_folder(tmp_path)
    record = json.loads((folder / "done.json").read_text())
    assert record == {"version": 1, "key": "key-1", "files": {name: file_sha256(folder / name) for name in ("model.bin", "sub/b.txt")}}
    for change in ({"version": 2}, {"more": 1}, {"files": []}, {"files": {"model.bin": 3}}, {"files": {"../model.bin": "0"}}):
        (folder / "done.json").write_text(json.dumps({**record, **change}))
        assert seal_problem(folder, "key-1") == f"{folder / 'done.json'} is not a seal of version 1."
    with pytest.raises(BadInput, match=r"cannot seal '\.\./a' in .*: give a name inside the folder"):
        seal(folder, "k", ["../a"])


def test_a_lock_names_its_process_and_is_a_hidden_file(tmp_path: Path) -> None:
    with RunLock(tmp_path) as lock:
        assert lock.path.name == ".lock" and lock.path.read_text() == f"{os.getpid()}\n"
    lock.__exit__()
    (tmp_path / ".lock").write_text("1234567890" * 5)
    with RunLock(tmp_path):
        assert (tmp_path / ".lock").read_text() == f"{os.getpid()}\n"


def test_different_things_have_different_keys() -> None:
    things = [
        1, 1.0, True, "1", b"1", None, "None", [1], [[1]], {"a": 1}, {"a": [1]}, ["a", 1], np.array([1]), np.array([1.0]), np.array([[1]]),
        np.array([1], np.int32), [], {}, "", b"", ["ab", "c"], ["a", "bc"], -0.0, 0.0, {"a": 1, "b": 2}, {"a": 2, "b": 1},
    ]  # fmt: skip
    assert len({content_key(thing) for thing in things}) == len(things)
    assert content_key(1, 2) != content_key([1, 2]) and content_key(np.int64(1)) == content_key(1) and content_key((1,)) == content_key([1])
    assert content_key({"a": 1, "b": 2}) == content_key({"b": 2, "a": 1})
    assert content_key(np.array([1, 2], ">i8")) == content_key(np.array([1, 2], "<i8")) == content_key(np.array([1, 9, 2])[::2])
    for wrong in (object(), {1, 2}, np.array([object()]), 1j):
        with pytest.raises(TypeError, match="content_key got"):
            content_key(wrong)


def test_a_holder_whose_name_is_garbled_is_shown_as_far_as_it_can_be(tmp_path: Path) -> None:
    for content, shown in ((b"\xff7", "\ufffd7"), (b"", "unknown"), (b"x" * 30, "x" * 20)):
        with RunLock(tmp_path):
            (tmp_path / ".lock").write_bytes(content)
            with pytest.raises(BadInput, match=rf"another process \({shown}\) is writing"), RunLock(tmp_path):
                pytest.fail("two writers at once")
