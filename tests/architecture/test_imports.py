"""Who may import whom, in which order, and what an import must not drag in."""

from __future__ import annotations

import ast
import importlib.metadata
import subprocess
import sys
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "open3d", "pyvista", "vtk", "pycolmap", "cv2", "scipy", "matplotlib", "PySide6")
PACKAGES = {
    "radiant_core": ROOT / "core/radiant_core",
    "radiant_viewer": ROOT / "viewer/radiant_viewer",
    "radiant_app": ROOT / "radiant_app",
    "radiant": ROOT / "radiant",
    "benchmarks": ROOT / "benchmarks",
}


def run_python(code: str) -> str:
    """What a fresh interpreter prints for `code`, run from outside the project folder."""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT.parent)
    return result.stdout.strip()


def modules_of(package: str) -> dict[str, Path]:
    """Each module of a package with its file."""
    folder = PACKAGES[package]
    files = {".".join([package, *file.relative_to(folder).with_suffix("").parts]): file for file in folder.rglob("*.py")}
    return {name.removesuffix(".__init__"): file for name, file in files.items()}


def imported_names(file: Path) -> Iterator[str]:
    """Every name that a file imports anywhere: at the top, inside functions, for types alone."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{file}: imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imports_within(modules: Mapping[str, Path]) -> dict[str, set[str]]:
    """The modules that each module imports; `from a.b import c` counts as a.b.c where that is a module, else as a.b."""
    graph = {}
    for module, file in modules.items():
        named = {name if name in modules else name.rpartition(".")[0] for name in imported_names(file)}
        graph[module] = (named & set(modules)) - {module}
    return graph


def first_circle(graph: Mapping[str, set[str]]) -> list[str]:
    """One circle of a graph, empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_modules_import_each_other_in_a_circle(package: str) -> None:
    # Lazy imports and those for types count: whoever reads one module of a circle has to read them
    # all.
    assert first_circle(imports_within(modules_of(package))) == []


@pytest.mark.parametrize("within", [*PACKAGES, "radiant_app.commands"])
def test_no_rooms_import_each_other_in_a_circle(within: str) -> None:
    depth = within.count(".") + 2
    rooms: dict[str, set[str]] = {}
    for module, imported in imports_within(modules_of(within.split(".", maxsplit=1)[0])).items():
        room, *others = (".".join(name.split(".")[:depth]) for name in (module, *imported))
        if room.startswith(f"{within}."):
            rooms.setdefault(room, set()).update(other for other in others if other.startswith(f"{within}.") and other != room)
    assert first_circle(rooms) == []


def test_a_circle_is_found_however_it_is_imported(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("def late():\n    from p.b import thing\n")
    (tmp_path / "b.py").write_text("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from p import a\n")
    modules = {"p.a": tmp_path / "a.py", "p.b": tmp_path / "b.py"}
    assert sorted(set(first_circle(imports_within(modules)))) == ["p.a", "p.b"]


def test_import_linter_keeps_every_contract() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    result = subprocess.run([linter, "--no-cache"], capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.returncode == 0, result.stdout
    assert ", 0 broken." in result.stdout


def test_the_command_line_imports_nothing_heavy() -> None:
    # `radiant --help` answers in under 0.5 s; a set of modules is the same on a busy machine, a
    # time is not.
    code = f"import sys, radiant_app.cli.app; print([name for name in {HEAVY!r} if name in sys.modules])"
    assert run_python(code) == "[]"


def test_the_systems_zlib_comes_before_pycolmaps() -> None:
    # pycolmap exports a zlib of its own, which Python's module must not be bound to.
    code = (
        "import radiant_core.sfm.reconstruct, sys, zlib; names = list(sys.modules); import pycolmap;"
        "names = list(sys.modules); assert names.index('zlib') < names.index('pycolmap');"
        "print(zlib.decompress(zlib.compress(b'radiant' * 9999)) == b'radiant' * 9999)"
    )
    assert run_python(code) == "True"


def test_the_core_package_imports_zlib_before_anything_else() -> None:
    _docstring, first, *_ = ast.parse((ROOT / "core/radiant_core/__init__.py").read_text()).body
    assert ast.unparse(first) == "import zlib"


def test_no_top_level_core_or_viewer_is_installed() -> None:
    # Other wheels ship a top-level `core`; installed beside ours, one would overwrite the other
    # without a word.
    ours = importlib.metadata.distribution("radiant-splats")
    top_level = {Path(file).parts[0] for file in ours.files or [] if Path(file).parts[0] != ".."}
    assert top_level & {"core", "viewer"} == set()
    assert top_level >= {"radiant_core"}
    code = "from importlib.util import find_spec as f; print([bool(f('radiant_' + n)) for n in ('core', 'viewer', 'app')])"
    assert run_python(code) == "[True, True, True]"


def test_the_version_is_the_installed_ones() -> None:
    assert run_python("import radiant_core; print(radiant_core.__version__)") == importlib.metadata.version("radiant-splats")
