"""Mutation testing: are there tests for what the planner, the readers and the upload protocol do? Run by hand, in minutes.

    python tests/stress/mutation.py --seed 0 --sample 150 --json mutants.json

Draws mutants at random from all there are, applies each in a forked process that imports the changed module in place of the file, and
runs the tests that name the module; with --whole a mutant that those leave alive meets all tests of its package. Killed: a test fails,
or nothing ends within the time limit. The parent holds the heavy libraries, so that a mutant costs its tests and nothing else.
mutmut 3 runs the whole suite first to learn which test reaches what, and rewrites every function of a copied tree into a switch between
its mutants: ten minutes before the first, and no random sample. The changes made here are of its kinds; those that hardly any
test could miss (every assignment to None, arguments left out) are not drawn, which lowers the score.

Left alone: docstrings, annotations, decorators, the sentences of errors and other texts with a blank.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.abc import Loader, MetaPathFinder
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
CORE = ROOT / "core" / "radiant_core"
PARTS = {
    "plan": sorted((CORE / "plan").glob("*.py")),
    "io": sorted(path for path in (CORE / "io").glob("*.py") if path.name != "upload.py"),
    "upload": [CORE / "io" / "upload.py", CORE / "aggregate" / "arrival.py", *sorted(CORE.glob("io/upload_*.py"))],
}
PACKAGE_TESTS = {
    "plan": ["tests/core/plan", "tests/app/test_plan_options.py", "tests/app/test_profile_file.py", "tests/app/test_system_file.py"],
    "io": ["tests/core/io", "tests/core/test_splats.py", "tests/app/test_run_folder.py"],
    "upload": ["tests/core/io", "tests/core/aggregate/test_arrival.py"],
}
SLOW_TESTS = "not test_flat_curves_share_a_million"
"""Left out: it takes a minute and more by itself."""
FIRST_LIMIT_S, LAST_LIMIT_S = 60, 400
"""Of processor time, so that a busy machine does not kill a mutant; of wall time ten times that."""
MEMORY_BYTES = 6 << 30
SWAPS: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Div, ast.Mod: ast.Div,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.MatMult: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """The `number`-th change that can be made to a file."""

    part: str
    path: str
    number: int
    line: int
    change: str


class _Changer(ast.NodeTransformer):
    """Counts every change it could make and makes the one that is `wanted`."""

    def __init__(self, wanted: int = -1) -> None:
        self.wanted, self.found = wanted, list[tuple[int, str]]()

    def _offer(self, line: int, change: str) -> bool:
        self.found.append((line, change))
        return len(self.found) - 1 == self.wanted

    def _visit_function(self, node: Any) -> Any:
        node.args.defaults = [self.visit(default) for default in node.args.defaults]
        node.args.kw_defaults = [None if default is None else self.visit(default) for default in node.args.kw_defaults]
        node.body = [statement if _is_docstring(statement) else self.visit(statement) for statement in node.body]
        return node

    visit_FunctionDef = visit_AsyncFunctionDef = _visit_function

    def visit_ClassDef(self, node: ast.ClassDef) -> Any:
        node.body = [statement if _is_docstring(statement) else self.visit(statement) for statement in node.body]
        return node

    def visit_Expr(self, node: ast.Expr) -> Any:
        return node if _is_docstring(node) else self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> Any:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_Import(self, node: Any) -> Any:
        return node

    visit_ImportFrom = visit_Import

    def visit_Raise(self, node: ast.Raise) -> Any:
        return node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> Any:
        return node

    def visit_If(self, node: ast.If) -> Any:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return node
        if self._offer(node.lineno, "the condition of an if is turned round"):
            node.test = ast.copy_location(ast.UnaryOp(op=ast.Not(), operand=node.test), node.test)
            return node
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> Any:
        for place, operator in enumerate(node.ops):
            if type(operator) in SWAPS and self._offer(node.lineno, _swap_text(operator)):
                node.ops[place] = SWAPS[type(operator)]()
        return self.generic_visit(node)

    def _visit_operator(self, node: Any) -> Any:
        if type(node.op) in SWAPS and self._offer(node.lineno, _swap_text(node.op)):
            node.op = SWAPS[type(node.op)]()
        return self.generic_visit(node)

    visit_BinOp = visit_BoolOp = visit_AugAssign = _visit_operator

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        if self._offer(node.lineno, f"{type(node.op).__name__} is left out"):
            return self.visit(node.operand)
        return self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> Any:
        value = node.value
        if isinstance(value, bool):
            changed: Any = not value
        elif isinstance(value, (int, float)):
            changed = value + 1
        elif isinstance(value, str) and value and " " not in value:
            changed = f"XX{value}XX"
        else:
            return node
        return ast.copy_location(ast.Constant(changed), node) if self._offer(node.lineno, f"{value!r} becomes {changed!r}") else node

    def visit_Continue(self, node: ast.Continue) -> Any:
        return ast.copy_location(ast.Break(), node) if self._offer(node.lineno, "continue becomes break") else node

    def visit_Break(self, node: ast.Break) -> Any:
        return ast.copy_location(ast.Continue(), node) if self._offer(node.lineno, "break becomes continue") else node


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _swap_text(operator: ast.AST) -> str:
    return f"{type(operator).__name__} becomes {SWAPS[type(operator)].__name__}"


def mutants_of(part: str, path: Path) -> list[Mutant]:
    """All mutants of a file."""
    changer = _Changer()
    changer.visit(ast.parse(path.read_text()))
    where = str(path.relative_to(ROOT))
    return [Mutant(part=part, path=where, number=n, line=line, change=change) for n, (line, change) in enumerate(changer.found)]


def mutated(source: str, number: int) -> str:
    """The source with its `number`-th change made."""
    return ast.unparse(ast.fix_missing_locations(_Changer(number).visit(ast.parse(source))))


class _Replaced(MetaPathFinder, Loader):
    """Gives one module from changed source in place of its file."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        self.name, self.path, self.source = name, path, source

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self) if fullname == self.name else None

    def create_module(self, spec: Any) -> Any:
        return None

    def exec_module(self, module: Any) -> None:
        exec(compile(self.source, str(self.path), "exec"), module.__dict__)


def tests_naming(module: str, part: str) -> list[str]:
    """The files among the package's tests that name a module; all of its tests where none does."""
    files = [
        file for place in PACKAGE_TESTS[part] for file in ([ROOT / place] if place.endswith(".py") else (ROOT / place).glob("test_*.py"))
    ]
    return sorted(str(file) for file in files if module in file.read_text()) or [str(ROOT / place) for place in PACKAGE_TESTS[part]]


def forked(work: Callable[[], int], limit_s: int) -> int | None:
    """The exit code of `work` in a process of its own; None when it had to be ended."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        code = 99
        try:
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 1))
            null = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(null, stream)
            code = work()
        finally:
            os._exit(code)
    deadline = time.monotonic() + 10 * limit_s
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return None if code == -signal.SIGXCPU else code
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def run_tests(tests: list[str], replaced: _Replaced | None) -> int:
    """Run tests in this process, which imports nothing of the project before; the exit code of pytest."""
    import pytest

    os.chdir(ROOT)
    if replaced is not None:
        sys.meta_path.insert(0, replaced)
    with tempfile.TemporaryDirectory(prefix="mutant.") as folder:
        options = ["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", "-k", SLOW_TESTS, f"--basetemp={folder}/tests"]
        return int(pytest.main([*options, *tests]))


def outcome_of(mutant: Mutant, *, whole: bool) -> str:
    """killed, timeout or survived; with `whole` what survives the tests that name the module meets all of its package."""
    path = ROOT / mutant.path
    module = ".".join(path.relative_to(ROOT / "core").with_suffix("").parts)
    replaced = _Replaced(module, path, mutated(path.read_text(), mutant.number))
    everything = [str(ROOT / place) for place in PACKAGE_TESTS[mutant.part]]
    rounds = [(tests_naming(module, mutant.part), FIRST_LIMIT_S), (everything, LAST_LIMIT_S)]
    for tests, limit_s in rounds if whole else rounds[:1]:
        code = forked(lambda tests=tests: run_tests(tests, replaced), limit_s)
        if code != 0:
            return "timeout" if code is None else "killed"
    return "survived"


def preload() -> None:
    """What tests import besides the project."""
    import numpy
    import pydantic
    import pytest
    import safetensors.numpy
    import scipy.optimize
    import scipy.spatial
    import shapely

    assert all((numpy, pydantic, pytest, safetensors, scipy, shapely))


def wilson(killed: int, tried: int) -> tuple[float, float]:
    """The 95 % interval of a share."""
    z, share = 1.96, killed / tried
    middle, half = share + z * z / (2 * tried), z * (share * (1 - share) / tried + z * z / (4 * tried * tried)) ** 0.5
    return (middle - half) / (1 + z * z / tried), (middle + half) / (1 + z * z / tried)


def drawn(parts: list[str], sample: int, seed: int) -> Iterator[Mutant]:
    """`sample` mutants of each part in random order, all where there are fewer."""
    for part in parts:
        every = [mutant for path in PARTS[part] for mutant in mutants_of(part, path)]
        chosen = random.Random(seed).sample(every, min(sample, len(every)))
        print(f"{part}: {len(every)} mutants, {len(chosen)} drawn", flush=True)
        yield from chosen


def main() -> None:
    """Draw, run, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="plan,io,upload")
    parser.add_argument("--sample", type=int, default=100, help="mutants of each part")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--json", type=Path, default=Path("mutants.json"), help="written after every mutant; what stands there is not run again"
    )
    parser.add_argument("--whole", action="store_true", help="what survives meets all tests of its package, minutes each")
    parser.add_argument("--again", action="store_true", help="run survivors that stand there once more")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = json.loads(arguments.json.read_text()) if arguments.json.is_file() else []
    rows = [row for row in rows if not (arguments.again and row["outcome"] == "survived")]
    known = {(row["path"], row["number"]) for row in rows}
    preload()
    for part in arguments.parts.split(",") if arguments.whole else ():
        code = forked(lambda part=part: run_tests([str(ROOT / place) for place in PACKAGE_TESTS[part]], None), LAST_LIMIT_S)
        if code != 0:
            sys.exit(f"the tests of {part} fail without any mutant (code {code}): mend them first.")
    for mutant in drawn(arguments.parts.split(","), arguments.sample, arguments.seed):
        if (mutant.path, mutant.number) not in known:
            rows.append({**asdict(mutant), "outcome": outcome_of(mutant, whole=arguments.whole)})
            arguments.json.write_text(json.dumps(rows, indent=1))
            if rows[-1]["outcome"] == "survived":
                print(f"survived: {mutant.path}:{mutant.line} {mutant.change}", flush=True)
    for part in arguments.parts.split(","):
        outcomes = [row["outcome"] for row in rows if row["part"] == part]
        killed = len(outcomes) - outcomes.count("survived")
        low, high = wilson(killed, len(outcomes))
        print(f"{part}: {killed} of {len(outcomes)} killed, {100 * killed / len(outcomes):.1f} % [{100 * low:.1f}, {100 * high:.1f}]")


if __name__ == "__main__":
    main()
