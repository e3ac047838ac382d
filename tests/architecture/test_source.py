"""What holds for every source file: it says what it is, its functions are short, and nothing catches everything."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("core/radiant_core", "viewer/radiant_viewer", "radiant_app", "radiant", "benchmarks", "examples", "sample_scenes")
SOURCES = sorted(path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
MAX_FUNCTION_LINES = 70
MAX_FILE_LINES = 500
MAX_PROSE_COLUMNS = 100

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def parsed(source: Path) -> ast.Module:
    return ast.parse((ROOT / source).read_text())


def functions(tree: ast.AST) -> Iterator[Function]:
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def num_lines(node: Function) -> int:
    assert node.end_lineno is not None
    return node.end_lineno - node.lineno + 1


def test_the_packages_are_found() -> None:
    assert {source.parts[0] for source in SOURCES} == {Path(package).parts[0] for package in PACKAGES}


def test_a_module_opens_with_what_it_is() -> None:
    assert [str(source) for source in SOURCES if not ast.get_docstring(parsed(source))] == []


def test_public_functions_and_classes_say_what_they_do() -> None:
    bare = [
        f"{source}:{node.lineno} {node.name}"
        for source in SOURCES
        for node in parsed(source).body
        if isinstance(node, Function | ast.ClassDef) and not node.name.startswith("_") and not ast.get_docstring(node)
    ]
    assert bare == []


def test_functions_and_files_stay_short() -> None:
    long = [
        f"{source}:{node.lineno} {node.name}"
        for source in SOURCES
        for node in functions(parsed(source))
        if num_lines(node) > MAX_FUNCTION_LINES
    ]
    assert long == []
    assert [str(source) for source in SOURCES if len((ROOT / source).read_text().splitlines()) > MAX_FILE_LINES] == []


def prose_lines(source: Path) -> Iterator[tuple[int, str]]:
    """Numbers and texts of the lines of docstrings and of those that have a comment."""
    lines = (ROOT / source).read_text().splitlines()
    numbers: set[int] = set()
    if source.suffix == ".py":
        for node in ast.walk(parsed(source)):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
                numbers.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    comment = re.compile(r"(^|\s)#\s" if source.suffix == ".py" else r"(^|\s)//")
    return ((number, line) for number, line in enumerate(lines, 1) if number in numbers or comment.search(line))


def test_prose_is_100_columns_wide() -> None:
    native = sorted(path.relative_to(ROOT) for path in (ROOT / "core/radiant_core/native").rglob("*") if path.suffix in (".cpp", ".h"))
    assert native
    wide = [f"{source}:{number}" for source in [*SOURCES, *native] for number, line in prose_lines(source) if len(line) > MAX_PROSE_COLUMNS]
    assert wide == []


def test_there_is_no_drawer_for_odds_and_ends() -> None:
    drawers = {"utils", "util", "helpers", "helper", "common", "misc"}
    assert [source for source in SOURCES if drawers & {*source.parts, source.stem}] == []


def test_setup_refuses_what_it_does_not_know_in_one_sentence() -> None:
    for arguments in (["tset"], ["demo", "test"]):
        result = subprocess.run(["./setup.sh", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
        assert result.returncode == 2
        assert len(result.stderr.strip().splitlines()) == 1
        assert arguments[-1] in result.stderr


def test_setup_says_size_and_time_before_it_downloads(tmp_path: Path) -> None:
    stub = 'if [[ "$*" == "-m venv .venv" ]]; then mkdir -p .venv/bin; cp "$0" .venv/bin/python; fi; echo "python $*"\n'
    for name, text in (("python3", stub), ("dpkg-query", "echo -n installed\n")):
        (tmp_path / "bin" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "bin" / name).write_text("#!/bin/bash\n" + text)
        (tmp_path / "bin" / name).chmod(0o755)
    for name in ("core/radiant_core/native", "viewer", "radiant_app", "radiant", "benchmarks/native"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("pyproject.toml", "CMakeLists.txt"):
        (tmp_path / name).touch()
    shutil.copy(ROOT / "setup.sh", tmp_path)
    path = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    said = subprocess.run(["./setup.sh"], cwd=tmp_path, capture_output=True, text=True, check=True, env=path).stdout
    before, _, after = said.partition("python -m pip install --editable")
    assert all(word in before for word in ("1.1 GB", "to download", "GB on disk", "minutes", "Building editable")), before
    assert "setup.sh: done" in after
    again = subprocess.run(["./setup.sh"], cwd=tmp_path, capture_output=True, text=True, check=True, env=path).stdout
    assert again.splitlines() == ["setup.sh: done; try .venv/bin/radiant --help"]


def test_no_message_shows_a_tuple_of_an_array() -> None:
    """numpy prints "(np.int64(319), np.int64(239))" there: shapes alone are plain numbers."""
    shown = [
        f"{source}:{node.lineno}"
        for source in SOURCES
        for node in ast.walk(parsed(source))
        if isinstance(node, ast.FormattedValue) and isinstance(call := node.value, ast.Call) and isinstance(call.func, ast.Name)
        if call.func.id == "tuple" and not ast.unparse(call.args[0]).endswith(".shape")
    ]
    assert shown == []


def test_the_packages_say_that_they_are_typed_and_the_citation_has_their_version() -> None:
    assert [package for package in PACKAGES[:4] if not (ROOT / package / "py.typed").is_file()] == []
    (version,) = re.findall(r'^__version__ = "(.+)"$', (ROOT / "core/radiant_core/__init__.py").read_text(), re.MULTILINE)
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
