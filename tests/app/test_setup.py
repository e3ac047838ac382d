"""What `./setup.sh` installs: with an environment that only writes down what it was asked, in a folder of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from radiant_app.network.serving import require_network
from radiant_core import extras
from radiant_core.errors import BadInput
from radiant_viewer.web import server as web
from radiant_viewer.window import desktop

ROOT = Path(__file__).parents[2]
NATIVE_SOURCE = "core/radiant_core/native/room/one.cpp"
ROOMS = ("core/radiant_core", "viewer/radiant_viewer", "radiant_app", "radiant")
EVERYDAY = "-m pip install --editable .[desktop,flip,geo,sfm,survey,web]"


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of the script beside a made-up environment, on a machine that has all system packages."""
    shutil.copy(ROOT / "setup.sh", tmp_path)
    rooms = [f"{room}/__init__.py" for room in ROOMS]
    for name in ("pyproject.toml", "CMakeLists.txt", NATIVE_SOURCE, "benchmarks/native/field/one.cpp", *rooms):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    program(tmp_path / "bin/dpkg-query", "echo installed")
    log = tmp_path / "log.txt"
    for name in ("python", "radiant", "lint-imports", "ruff", "pyright"):
        program(tmp_path / ".venv/bin" / name, f'[ "$1" = -VV ] || echo "{name} $*" >> "{log}"')
    return tmp_path


def setup(checkout: Path, *arguments: str) -> list[str]:
    """What the environment's programs were asked by one call of the script."""
    (checkout / "log.txt").write_text("")
    environment = {**os.environ, "PATH": f"{checkout / 'bin'}:{os.environ['PATH']}"}
    subprocess.run(["./setup.sh", *arguments], cwd=checkout, env=environment, capture_output=True, check=True)
    return [line for line in (checkout / "log.txt").read_text().splitlines() if line != "python -m pip --version"]


def test_clang_builds_in_a_folder_of_its_own_and_again_only_after_a_change(checkout: Path) -> None:
    program(checkout / "bin/clang++", "exit 1")
    wheel = "python -m pip wheel --quiet --no-deps --wheel-dir build/clang --config-settings=build-dir=build/clang/cmake ."
    contract = "python -S -m pytest tests/contract/test_rasterizers.py tests/contract/test_absgrad.py -p no:cacheprovider"
    first, second = setup(checkout, "clang"), setup(checkout, "clang")
    assert wheel in first and first[-1] == contract
    assert wheel not in second and second[-1] == contract
    (checkout / NATIVE_SOURCE).write_text("changed")
    assert wheel in setup(checkout, "clang")


def test_the_demo_brings_what_inspect_needs_and_is_not_set_up_twice(checkout: Path) -> None:
    assert setup(checkout, "demo") == [f"python {EVERYDAY}", "radiant demo"]
    assert setup(checkout, "demo") == ["radiant demo"]
    assert setup(checkout) == []
    # Sources that changed are installed again, and an environment that is older than the extras
    # gets them.
    for source in ("pyproject.toml", NATIVE_SOURCE):
        (checkout / source).write_text("changed")
        assert setup(checkout) == [f"python {EVERYDAY}"]
    # The installation knows a module by its file: one that became a folder is installed again.
    (checkout / "radiant_app/commands").mkdir()
    (checkout / "radiant_app/commands/__init__.py").touch()
    assert setup(checkout) == [f"python {EVERYDAY}"]
    (checkout / ".venv/installed-desktop,flip,geo,sfm,survey,web").rename(checkout / ".venv/installed-base")
    assert setup(checkout, "demo") == [f"python {EVERYDAY}", "radiant demo"]


def test_the_tests_bring_the_everyday_extras_too(checkout: Path) -> None:
    assert setup(checkout, "check")[0] == "python -m pip install --editable .[test]"
    assert setup(checkout) == []
    assert 'test = [\n    "radiant-splats[cluster,desktop,flip,geo,network,sfm,survey,usd,web]"' in (ROOT / "pyproject.toml").read_text()


@pytest.mark.parametrize("failing", ["lint-imports", "ruff", "pyright"])
def test_a_check_that_fails_ends_the_command(failing: str, checkout: Path) -> None:
    """Though types are checked beside the others."""
    program(checkout / ".venv/bin" / failing, "exit 3")
    with pytest.raises(subprocess.CalledProcessError) as ended:
        setup(checkout, "check")
    assert ended.value.returncode == 3


def test_a_missing_extra_names_the_command_that_installs_it_here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """For the Python that runs, from any folder; without pip, by uv; without an installation, by the set-up of the source."""

    def found(*absent: str) -> None:
        monkeypatch.setattr(extras, "find_spec", lambda name: None if name in absent else object())

    requirements = (
        ("desktop", desktop.require_desktop, "PySide6"),
        ("web", web.require_web, "trame"),
        ("network", require_network, "httpx"),
    )
    for extra, require, module in requirements:
        found(module)
        with pytest.raises(BadInput) as caught:
            require()
        assert f"-m pip install 'radiant-splats[{extra}]', or " in str(caught.value) and module in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
    monkeypatch.setattr(sys, "executable", str(tmp_path / "my venv" / "bin" / "python"))
    found()
    assert extras.install_command("web") == f"'{tmp_path}/my venv/bin/python' -m pip install 'radiant-splats[web]'"
    monkeypatch.chdir(tmp_path)
    assert extras.install_command("web") == "'my venv/bin/python' -m pip install 'radiant-splats[web]'"
    found("pip")
    assert extras.install_command("web").startswith("uv pip install --python ")
    monkeypatch.setattr(extras, "DISTRIBUTION", "no-such-thing")
    assert extras.install_command("web") == str(ROOT / "setup.sh")


def test_every_extra_is_in_the_table_and_every_line_of_it_is_an_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(extras.EXTRAS) == set(project["optional-dependencies"]) - {"test"}


def test_a_placed_scene_needs_neither_pycolmap_nor_flip(tmp_path: Path) -> None:
    """Photographs without poses end with the command that brings it, before anything is written."""
    for name, target in (("images", "images"), ("sparse", "known")):
        (tmp_path / name).symlink_to(ROOT / "sample_scenes" / "hamlet" / target)
    script = "import sys; sys.modules |= {'pycolmap': None, 'flip_evaluator': None}\nfrom radiant_app.cli.app import main; main()"

    def radiant(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, check=False)

    trained = radiant("train", tmp_path, "--out", tmp_path / "model", "--steps", "2", "--long-side-px", "64", "--json")
    assert trained.returncode == 0, trained.stderr
    assert json.loads(trained.stdout)["flip"] is None
    placed = radiant("sfm", tmp_path / "images", "--out", tmp_path / "scene")
    assert placed.returncode == 2 and "-m pip install 'radiant-splats[sfm]', or " in placed.stderr
    assert not (tmp_path / "scene").exists()


def test_a_bare_root_is_given_folders_with_blanks_in_their_names(tmp_path: Path) -> None:
    """Its second start, in mounts of its own, gets the arguments of the first."""
    program(tmp_path / "bin/unshare", f'for word in "$@"; do echo "$word"; done > "{tmp_path}/given"')
    text = (ROOT / "tools/bare_root.sh").read_text()
    tool = tmp_path / "bare_root.sh"
    tool.write_text(text.replace("$EUID -eq 0", "1 -eq 1"))
    assert tool.read_text() != text
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    line = ["bash", str(tool), "--test", "--bind", "/a folder", "--bind", "/b", "trixie", "/tmp/a root"]
    subprocess.run(line, check=True, env={**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"})
    given = (tmp_path / "given").read_text().splitlines()
    assert given == ["--mount", "--propagation", "private", str(tool), *line[2:]]
