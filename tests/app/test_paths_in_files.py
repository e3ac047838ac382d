"""Paths that can name nothing, in every file that a user writes and every field that is a path: one sentence, no traceback."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiant_app.config.fields import config_fields
from radiant_app.config.paths import path_of_text
from radiant_app.files.job_file import load_jobs, load_run_file
from radiant_app.files.toml_file import load_toml
from radiant_core.errors import BadInput

PATHS = sorted(path for path, field in config_fields().items() if field.is_path)


def run_file(folder: Path, path: str, value: str) -> Path:
    (folder / "loop").symlink_to(folder / "loop")
    section, _, name = path.rpartition(".")
    file = folder / "RUN.toml"
    file.write_text(f"{f'[{section}]' if section else ''}\n{name} = {value}\n")
    return file


def test_there_are_paths_to_try() -> None:
    assert {"source", "out", "system"} <= {*PATHS}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    ("value", "said"),
    [
        (r'"a\u0000b"', r"RUN.toml: {path} holds the character U\+0000"),
        ('"~nobody-of-this-name/a"', r"RUN.toml: {path} is '~nobody-of-this-name/a', and there is no such user here"),
        ('"loop/a"', r"RUN.toml: {path} is 'loop/a', which cannot be followed \(its links lead to each other\)"),
    ],
    ids=["NUL", "home of nobody", "loop of links"],
)
def test_a_run_file_with_an_impossible_path_is_one_sentence(tmp_path: Path, path: str, value: str, said: str) -> None:
    with pytest.raises(BadInput, match=said.format(path=path)):
        load_run_file(run_file(tmp_path, path, value))


@pytest.mark.parametrize("key", ["source", "out", "system", "masks"])
@pytest.mark.parametrize(
    ("value", "said"),
    [(r'"a\u0000b"', r"U\+0000"), ('"~nobody-of-this-name/a"', "no such user here"), ('"loop/a"', "links lead to each other")],
    ids=["NUL", "home of nobody", "loop of links"],
)
def test_a_job_file_with_an_impossible_path_is_one_sentence(tmp_path: Path, key: str, value: str, said: str) -> None:
    (tmp_path / "photos").mkdir()
    for folder in (tmp_path, tmp_path / "batch"):
        folder.mkdir(exist_ok=True)
        (folder / "loop").symlink_to(folder / "loop")
    given = {"name": '"a"', "source": '"photos"', key: value}
    (tmp_path / "JOBS.toml").write_text("[[job]]\n" + "".join(f"{name} = {text}\n" for name, text in given.items()))
    with pytest.raises(BadInput, match=rf"JOBS.toml: .*{said}"):
        load_jobs(tmp_path / "JOBS.toml", tmp_path / "batch")


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (r"[[edge]]" + "\n" + r'id = "e\u0000"', "edge.id"),
        (r"[[edge]]" + "\n" + r'devices = [{profile = "\u0000"}]', "edge.devices.profile"),
        (r'"a\u0000b" = 1', r"a\\0b"),
        (r'a = [["x", "\u0000"]]', "a"),
    ],
)
def test_a_text_with_nul_is_named_in_any_file(tmp_path: Path, text: str, key: str) -> None:
    (tmp_path / "fleet.toml").write_text(text)
    with pytest.raises(
        BadInput, match=rf"fleet.toml: {key} holds the character U\+0000, which neither a text nor a path of a system file has"
    ):
        load_toml(tmp_path / "fleet.toml", "system file")


@pytest.mark.parametrize("text", ["a\0b", "a\ud800"])
def test_a_path_from_elsewhere_is_checked_alike(text: str) -> None:
    with pytest.raises(BadInput, match=r"--system is .*, which holds a character that no path can have"):
        config_fields()["system"].of_option(text)


def test_names_that_are_no_utf_8_are_paths() -> None:
    assert path_of_text("a\udcff", "out") == Path("a\udcff")
