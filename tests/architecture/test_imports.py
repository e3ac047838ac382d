"""Who may import whom, in which order, and what an import must not drag in."""

from __future__ import annotations

import ast
import importlib.metadata
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "open3d", "pyvista", "vtk", "pycolmap", "cv2", "scipy", "matplotlib", "PySide6")


def run_python(code: str) -> str:
    """What a fresh interpreter prints for `code`, run from outside the project folder."""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT.parent)
    return result.stdout.strip()


def test_import_linter_keeps_every_contract() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    result = subprocess.run([linter, "--no-cache"], capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.returncode == 0, result.stdout
    assert ", 0 broken." in result.stdout


def test_the_command_line_imports_nothing_heavy() -> None:
    # `radiant --help` answers in under 0.5 s; a set of modules is the same on a busy machine, a time is not.
    code = f"import sys, radiant_app.cli.app; print([name for name in {HEAVY!r} if name in sys.modules])"
    assert run_python(code) == "[]"


def test_the_systems_zlib_comes_before_pycolmaps() -> None:
    # pycolmap exports a zlib of its own: where it is loaded first, zlib.compress aborts the process.
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
    # Other wheels ship a top-level `core`; installed beside ours, one would overwrite the other without a word.
    ours = importlib.metadata.distribution("radiant-splats")
    top_level = {Path(file).parts[0] for file in ours.files or [] if Path(file).parts[0] != ".."}
    assert top_level & {"core", "viewer"} == set()
    assert top_level >= {"radiant_core"}
    code = "from importlib.util import find_spec as f; print([bool(f('radiant_' + n)) for n in ('core', 'viewer', 'app')])"
    assert run_python(code) == "[True, True, True]"


def test_the_version_is_the_installed_ones() -> None:
    assert run_python("import radiant_core; print(radiant_core.__version__)") == importlib.metadata.version("radiant-splats")
