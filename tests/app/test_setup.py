"""What `./setup.sh` installs: with an environment that only writes down what it was asked, in a folder of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from radiant_core.errors import BadInput
from radiant_viewer.web import server as web
from radiant_viewer.window import desktop

ROOT = Path(__file__).parents[2]
NATIVE_SOURCE = "core/radiant_core/native/room/one.cpp"
EVERYDAY = "-m pip install --editable .[desktop,web]"


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of the script beside a made-up environment, on a machine that has all system packages."""
    shutil.copy(ROOT / "setup.sh", tmp_path)
    for name in ("pyproject.toml", "CMakeLists.txt", NATIVE_SOURCE):
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


def test_the_demo_brings_what_inspect_needs_and_is_not_set_up_twice(checkout: Path) -> None:
    assert setup(checkout, "demo") == [f"python {EVERYDAY}", "radiant demo"]
    assert setup(checkout, "demo") == ["radiant demo"]
    assert setup(checkout) == []
    # Sources that changed are installed again, and an environment that is older than the extras
    # gets them.
    for source in ("pyproject.toml", NATIVE_SOURCE):
        (checkout / source).write_text("changed")
        assert setup(checkout) == [f"python {EVERYDAY}"]
    (checkout / ".venv/installed-desktop,web").rename(checkout / ".venv/installed-base")
    assert setup(checkout, "demo") == [f"python {EVERYDAY}", "radiant demo"]


def test_the_tests_bring_the_everyday_extras_too(checkout: Path) -> None:
    assert setup(checkout, "check")[0] == "python -m pip install --editable .[test]"
    assert setup(checkout) == []
    assert 'test = [\n    "radiant-splats[cluster,desktop,network,web]"' in (ROOT / "pyproject.toml").read_text()


def test_a_missing_extra_names_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desktop.importlib.util, "find_spec", lambda name: None)
    for require, extra in ((desktop.require_desktop, "desktop"), (web.require_web, "web")):
        with pytest.raises(BadInput) as caught:
            require()
        assert "./setup.sh" in str(caught.value) and f".venv/bin/pip install -e '.[{extra}]'" in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
