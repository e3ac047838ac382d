"""Where `radiant demo` finds its photographs: in the project's source, or inside the installed package."""

from __future__ import annotations

from pathlib import Path

import pytest

import radiant_app
from radiant_app.commands.run.demo import demo_config, sample_scenes_folder
from radiant_core.errors import BadInput

ROOT = Path(__file__).parents[2]


def pretend_installed(monkeypatch: pytest.MonkeyPatch, packages: Path) -> Path:
    """`radiant_app` as if it lay in a folder of packages; returns its own folder."""
    package = packages / "radiant_app"
    package.mkdir(parents=True)
    monkeypatch.setattr(radiant_app, "__file__", str(package / "__init__.py"))
    return package


def test_the_source_has_its_scenes_beside_the_packages() -> None:
    assert sample_scenes_folder() == ROOT / "sample_scenes"


def test_an_installed_package_has_the_town_inside(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    package = pretend_installed(monkeypatch, tmp_path)
    (package / "sample_scenes").symlink_to(ROOT / "sample_scenes")
    assert demo_config(tmp_path / "out").source == package / "sample_scenes" / "town" / "images"


def test_an_installation_without_scenes_says_how_to_get_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pretend_installed(monkeypatch, tmp_path)
    # A folder of that name by somebody else's package is none of ours.
    (tmp_path / "sample_scenes").mkdir()
    with pytest.raises(BadInput, match="not in this installation: install Radiant's wheel again"):
        sample_scenes_folder()
