"""Mutation testing: are there tests for what the planner, the readers and the upload protocol do?
Run by hand, in minutes.

    python tests/stress/mutation.py --seed 0 --sample 60 --json mutants.json

Draws mutants at random from all there are and runs, for each, the tests that reach its lines: those
of the module's own file first, then the quickest. Killed: a test fails, or takes ten times its
processor time. What each of it costs:

    once per part      all tests of the part, traced: which lines does each reach, in what time; a failure ends it all
    once per mutant    a fork of a session whose tests are imported and collected: the code objects of the changed functions are exchanged
    constants, defaults, and what runs at import    a fork of a process that has the heavy libraries alone: everything is imported anew

A mutant that no test reaches survives at once. The changes are of mutmut's kinds; those that hardly
any test could miss (every assignment to None, arguments left out) are not drawn, which lowers the
score. Left alone: docstrings, annotations, decorators, the sentences of errors and other texts with
a blank.
"""

from __future__ import annotations

import argparse
import ast
import gc
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from importlib.abc import Loader, MetaPathFinder
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
CORE, APP = ROOT / "core" / "radiant_core", ROOT / "radiant_app"
PROTOCOL = [CORE / "io/transport" / f"{name}.py" for name in ("acceptance", "delivery", "signing", "upload")]
PARTS = {
    "plan": sorted((CORE / "plan").rglob("*.py")),
    "io": sorted(path for path in (CORE / "io").rglob("*.py") if path not in PROTOCOL),
    "upload": [*PROTOCOL, CORE / "aggregate" / "arrival.py", APP / "workers" / "delivering.py", APP / "workers" / "inbox.py"],
}
PACKAGE_TESTS = {
    "plan": ["tests/core/plan", "tests/app/test_plan_options.py", "tests/app/test_profile_file.py", "tests/app/test_system_file.py"],
    "io": ["tests/core/io", "tests/core/test_splats.py", "tests/app/test_run_folder.py", "tests/app/test_plan_content.py"],
    "upload": [
        "tests/core/io",
        "tests/core/aggregate/test_arrival.py",
        "tests/app/test_delivering.py",
        "tests/app/test_inbox.py",
        "tests/app/test_task_schema.py",
    ],
}
SLOW_TESTS = "not test_flat_curves_share_a_million"
"""Left out: it takes a minute and more by itself."""
LIMIT_S, LIMIT_TIMES = 3.0, 10.0
"""A test may take so much processor time and so many times what it takes without a mutant; a busy machine kills none."""
WALL_LIMIT_S = 600.0
"""A mutant that waits for something: undecided, it does not count."""
MEMORY_BYTES = 6 << 30
OWN_FAULT = 99
"""Exit code of a fork in which something else than a test failed."""
OPTIONS = ["-q", "-s", "-W", "ignore:Module already imported", "-p", "no:cacheprovider", "--hypothesis-seed=0", "-k", SLOW_TESTS]
SWAPS: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Div, ast.Mod: ast.Div,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.MatMult: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """The `number`-th change that can be made to a file; made at `line`, within the lines `first` to `last` of its statement."""

    part: str
    path: str
    number: int
    line: int
    first: int
    last: int
    in_function: bool
    change: str


class _Changer(ast.NodeTransformer):
    """Counts every change it could make and makes the one that is `wanted`."""

    def __init__(self, wanted: int = -1) -> None:
        self.wanted, self.found = wanted, list[dict[str, Any]]()
        self.statement_line, self.depth = 0, 0

    def _offer(self, node: Any, change: str) -> bool:
        last = (node.test if isinstance(node, ast.If) else node).end_lineno
        where = {"line": node.lineno, "first": min(self.statement_line or node.lineno, node.lineno), "last": last}
        self.found.append({**where, "in_function": self.depth > 0, "change": change})
        return len(self.found) - 1 == self.wanted

    def visit(self, node: ast.AST) -> Any:
        if isinstance(node, ast.stmt):
            self.statement_line = node.lineno
        return super().visit(node)

    def _visit_function(self, node: Any) -> Any:
        node.args.defaults = [self.visit(default) for default in node.args.defaults]
        node.args.kw_defaults = [None if default is None else self.visit(default) for default in node.args.kw_defaults]
        self.depth += 1
        node.body = [statement if _is_docstring(statement) else self.visit(statement) for statement in node.body]
        self.depth -= 1
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
        if self._offer(node, "the condition of an if is turned round"):
            node.test = ast.copy_location(ast.UnaryOp(op=ast.Not(), operand=node.test), node.test)
            return node
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> Any:
        for place, operator in enumerate(node.ops):
            if type(operator) in SWAPS and self._offer(node, _swap_text(operator)):
                node.ops[place] = SWAPS[type(operator)]()
        return self.generic_visit(node)

    def _visit_operator(self, node: Any) -> Any:
        if type(node.op) in SWAPS and self._offer(node, _swap_text(node.op)):
            node.op = SWAPS[type(node.op)]()
        return self.generic_visit(node)

    visit_BinOp = visit_BoolOp = visit_AugAssign = _visit_operator

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        if self._offer(node, f"{type(node.op).__name__} is left out"):
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
        return ast.copy_location(ast.Constant(changed), node) if self._offer(node, f"{value!r} becomes {changed!r}") else node

    def visit_Continue(self, node: ast.Continue) -> Any:
        return ast.copy_location(ast.Break(), node) if self._offer(node, "continue becomes break") else node

    def visit_Break(self, node: ast.Break) -> Any:
        return ast.copy_location(ast.Continue(), node) if self._offer(node, "break becomes continue") else node


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _swap_text(operator: ast.AST) -> str:
    return f"{type(operator).__name__} becomes {SWAPS[type(operator)].__name__}"


def mutants_of(part: str, path: Path) -> list[Mutant]:
    """All mutants of a file."""
    changer = _Changer()
    changer.visit(ast.parse(path.read_text()))
    where = str(path.relative_to(ROOT))
    return [Mutant(part=part, path=where, number=number, **found) for number, found in enumerate(changer.found)]


def module_of(path: Path) -> str:
    """The name under which a file is imported."""
    return ".".join(path.relative_to(ROOT if path.is_relative_to(APP) else ROOT / "core").with_suffix("").parts)


def mutated(path: Path, number: int) -> CodeType:
    """The module's code with its `number`-th change made, -1 for none; every line keeps its number."""
    return compile(ast.fix_missing_locations(_Changer(number).visit(ast.parse(path.read_text()))), str(path), "exec", dont_inherit=True)


class _Replaced(MetaPathFinder, Loader):
    """Gives one module from changed code in place of its file."""

    def __init__(self, name: str, path: Path, code: CodeType) -> None:
        self.name, self.path, self.code = name, path, code

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self) if fullname == self.name else None

    def create_module(self, spec: Any) -> Any:
        return None

    def exec_module(self, module: Any) -> None:
        exec(self.code, module.__dict__)


def _codes_in(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes_in(constant)


def exchange_code(path: Path, number: int, functions: list[FunctionType]) -> None:
    """Give the living functions of a file the code that they have in its mutant."""
    codes = {(code.co_qualname, code.co_firstlineno): code for code in _codes_in(mutated(path, number))}
    for function in functions:
        if function.__code__.co_filename == str(path):
            function.__code__ = codes[function.__code__.co_qualname, function.__code__.co_firstlineno]


class Tracer:
    """Which lines of some files run."""

    def __init__(self, paths: list[Path]) -> None:
        self.lines: dict[str, set[int]] = {str(path): set() for path in paths}

    def taken(self) -> dict[str, list[int]]:
        """The lines since the last call."""
        found = {path: sorted(lines) for path, lines in self.lines.items() if lines}
        for lines in self.lines.values():
            lines.clear()
        return found

    def start(self) -> None:
        """Trace this thread and all that begin from now on."""
        threading.settrace(self._enter)
        sys.settrace(self._enter)

    def stop(self) -> None:
        """Trace nothing any more."""
        threading.settrace(None)  # type: ignore[arg-type]
        sys.settrace(None)

    def _enter(self, frame: FrameType, event: str, argument: Any) -> Any:
        # Class and module bodies are not functions: what stands in them is imported anew anyway.
        if frame.f_code.co_filename not in self.lines or not frame.f_code.co_flags & 0x2:
            return None
        return self._line

    def _line(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            self.lines[frame.f_code.co_filename].add(frame.f_lineno)
        return self._line


@dataclass(kw_only=True)
class Reach:
    """What each test (by its id) reaches and takes, and what runs while tests are imported."""

    lines: dict[str, dict[str, list[int]]] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    at_import: dict[str, list[int]] = field(default_factory=dict)

    def tests_for(self, mutant: Mutant) -> list[str]:
        """The tests that reach a mutant's statement, in the order to run them; where it runs at
        import, all that reach anything of its file or stand in a file that names its module."""
        path, wanted = str(ROOT / mutant.path), set(range(mutant.first, mutant.last + 1))
        if self.is_exchangeable(mutant):
            found = [test for test, lines in self.lines.items() if wanted & set(lines.get(path, ()))]
        else:
            files = {test.split("::")[0] for test in self.lines}
            naming = {file for file in files if module_of(ROOT / mutant.path) in (ROOT / file).read_text()}
            found = [test for test, lines in self.lines.items() if path in lines or test.split("::")[0] in naming]
        own = f"test_{Path(mutant.path).stem}.py"
        # By half seconds: what belongs to the module goes first among equally quick ones.
        return sorted(found, key=lambda test: (self.cpu_s[test] // 0.5, own not in test, self.cpu_s[test]))

    def is_exchangeable(self, mutant: Mutant) -> bool:
        """Whether the change runs in tests alone, never while something is imported."""
        return mutant.in_function and not set(range(mutant.first, mutant.last + 1)) & set(self.at_import.get(str(ROOT / mutant.path), ()))


def _processor_s() -> float:
    return sum(os.times()[:4])


class Session:
    """A pytest plugin: what runs in place of pytest's loop over tests is `work(self)`, with all tests collected."""

    def __init__(self, work: Callable[[Session], None], traced: list[Path]) -> None:
        self.work, self.tracer = work, Tracer(traced)
        self.items: dict[str, Any] = {}
        self.at_import: dict[str, list[int]] = {}
        self.failure = ""

    def pytest_collection(self) -> None:
        """A failing example need not be made small; this comes after conftest.py and before what is decorated in test files."""
        from hypothesis import Phase, settings

        settings.register_profile("mutation", settings.default, phases=(Phase.explicit, Phase.generate))
        settings.load_profile("mutation")

    def pytest_runtestloop(self, session: Any) -> bool:
        """Do the work."""
        self.tracer.stop()
        self.at_import = self.tracer.taken()
        if session.testsfailed:
            self.failure = "the tests cannot be collected"
        self.items = {item.nodeid: item for item in session.items}
        self.work(self)
        return True

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Keep what failed, with the last line of its reason."""
        if report.failed:
            self.failure = f"{report.nodeid}: {(report.longreprtext.strip().splitlines() or [''])[-1][:200]}"

    def run_one(self, test: str, following: str | None) -> None:
        """Run one test; `following` is the next, for the fixtures that both use."""
        item, next_item = self.items[test], None if following is None else self.items[following]
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=next_item)

    def run_until_failure(self, tests: list[str], cpu_s: dict[str, float]) -> None:
        """Run tests until one fails; one that takes far too long ends the process by SIGPROF."""
        for test, following in zip(tests, [*tests[1:], None], strict=True):
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S + LIMIT_TIMES * cpu_s[test])
            self.run_one(test, following)
            if self.failure:
                return


def run_session(session: Session, tests: list[str], folder: str, *options: str) -> int:
    """pytest over `tests` with the session in place of its own loop; what tests write goes below `folder`."""
    import pytest

    os.chdir(folder)
    where = [f"--rootdir={ROOT}", f"--config-file={ROOT / 'pyproject.toml'}", f"--basetemp={folder}/tests"]
    session.tracer.start()
    return int(pytest.main([*OPTIONS, *where, *options, *(str(ROOT / test) for test in tests)], plugins=[session]))


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a forked process ended: its exit code (below 0: a signal; None: ended by us), what it told, what it took."""

    code: int | None
    told: Any
    cpu_s: float


def forked(work: Callable[[], Any], wall_limit_s: float = WALL_LIMIT_S) -> Ended:
    """Run `work` in a process of its own; it tells what it returns as JSON."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        code = OWN_FAULT
        try:
            os.close(reader)
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
            told = json.dumps(work()).encode()
            with os.fdopen(writer, "wb") as file:
                file.write(told)
            code = 0
        except BaseException:
            traceback.print_exc()
            raise
        finally:
            os._exit(code)
    os.close(writer)
    timer = threading.Timer(wall_limit_s, lambda: os.killpg(child, signal.SIGKILL))
    timer.start()
    with os.fdopen(reader, "rb") as file:
        told = file.read()
    _, status, used = os.wait4(child, 0)
    is_late = not timer.is_alive()
    timer.cancel()
    code = os.waitstatus_to_exitcode(status)
    return Ended(code=None if is_late else code, told=json.loads(told) if told else None, cpu_s=used.ru_utime + used.ru_stime)


def outcome_of(ended: Ended) -> tuple[str, str]:
    """killed, timeout, survived or undecided, and by what."""
    if ended.code is None:
        return "undecided", "it waits for something"
    if ended.code == OWN_FAULT:
        return "undecided", "this script failed"
    if ended.code == -signal.SIGPROF:
        return "timeout", "ten times the processor time"
    if ended.code != 0:
        return "killed", f"the process ended with {ended.code}"
    return ("killed", ended.told) if ended.told else ("survived", "")


def measure_reach(session: Session, paths: list[Path], functions: list[FunctionType]) -> Reach:
    """Run all tests with code exchanged for the same code, traced."""
    for path in paths:
        exchange_code(path, -1, functions)
    reach, tests = Reach(at_import=session.at_import), list(session.items)
    session.tracer.start()
    for test, following in zip(tests, [*tests[1:], None], strict=True):
        started_s = _processor_s()
        session.run_one(test, following)
        reach.cpu_s[test] = _processor_s() - started_s
        reach.lines[test] = session.tracer.taken()
        if session.failure:
            reach.failed.append(session.failure)
            session.failure = ""
    return reach


def exchange_rounds(session: Session, part: str, mutants: list[Mutant], write: Callable[[dict[str, Any]], None]) -> None:
    """Measure what tests reach, then one fork per mutant; those that need an import of their own are left as `fresh` with their tests."""
    if session.failure:
        sys.exit(session.failure)
    names = {str(path) for path in PARTS[part]}
    functions = [one for one in gc.get_objects() if type(one) is FunctionType and one.__code__.co_filename in names]
    measured = forked(lambda: asdict(measure_reach(session, PARTS[part], functions)))
    reach = Reach(**measured.told)
    write({"part": part, "outcome": "reach", "cpu_s": measured.cpu_s, "tests": len(reach.lines), "failed": reach.failed})
    if reach.failed:
        return
    for mutant in mutants:
        tests = reach.tests_for(mutant)
        row = {**asdict(mutant), "tests": len(tests), "cpu_s": 0.0}
        if not tests:
            write({**row, "outcome": "survived", "by": "no test reaches it"})
        elif not reach.is_exchangeable(mutant):
            write({**row, "outcome": "fresh", "by": [tests, {test: reach.cpu_s[test] for test in tests}]})
        else:

            def run(mutant: Mutant = mutant, tests: list[str] = tests) -> str:
                exchange_code(ROOT / mutant.path, mutant.number, functions)
                session.run_until_failure(tests, reach.cpu_s)
                return session.failure

            ended = forked(run)
            outcome, by = outcome_of(ended)
            write({**row, "outcome": outcome, "by": by, "cpu_s": ended.cpu_s})


def run_fresh(mutant: Mutant, tests: list[str], cpu_s: dict[str, float], folder: str) -> str:
    """Import everything anew with the mutant in place of its file; what fails."""
    path = ROOT / mutant.path
    sys.meta_path.insert(0, _Replaced(module_of(path), path, mutated(path, mutant.number)))
    # Imports are a part of it: a change may make them endless.
    signal.setitimer(signal.ITIMER_PROF, 60)
    files = sorted({test.split("::")[0] for test in tests})

    def run(session: Session) -> None:
        # Parameters may come from the mutant: tests that only it has are run as well.
        order = [*(test for test in tests if test in session.items), *(test for test in session.items if test not in cpu_s)]
        if not session.failure:
            session.run_until_failure(order, {**dict.fromkeys(session.items, 1.0), **cpu_s})

    session = Session(run, [])
    code = run_session(session, files, folder)
    return session.failure or ("" if code in (0, 5) else f"pytest ended with {code}")


def preload() -> None:
    """What tests import besides the project."""
    import cryptography.hazmat.primitives.serialization
    import cv2
    import hypothesis
    import jaxtyping
    import matplotlib
    import numpy
    import open3d
    import pydantic
    import pytest
    import safetensors.numpy
    import scipy.optimize
    import scipy.spatial
    import shapely
    import torch
    import typer

    assert all((cryptography, cv2, hypothesis, jaxtyping, matplotlib, numpy, open3d, pydantic, pytest, safetensors, scipy, shapely, typer))
    torch.set_num_threads(1)


def rows_of(part: str, mutants: list[Mutant], folder: str) -> Iterator[dict[str, Any]]:
    """Run the mutants of a part; a row for each, and one of what measuring the reach took."""
    log = Path(folder) / "rows.jsonl"

    def write(row: dict[str, Any]) -> None:
        with log.open("a") as file:
            file.write(json.dumps(row) + "\n")

    def all_in_one_session() -> str:
        _silence(folder)
        session = Session(lambda session: exchange_rounds(session, part, mutants, write), PARTS[part])
        run_session(session, PACKAGE_TESTS[part], folder)
        return session.failure

    ended = forked(all_in_one_session, wall_limit_s=1e6)
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
    said = (Path(folder) / "said.txt").read_text()[-2000:]
    if not rows or rows[0]["failed"] or len(rows) != len(mutants) + 1:
        sys.exit(f"the tests of {part} fail without any mutant, mend them first: {rows[0]['failed'] if rows else ended} {said}")
    for row in rows:
        if row["outcome"] == "fresh":
            mutant = Mutant(**{name: row[name] for name in Mutant.__dataclass_fields__})
            tests, cpu_s = row["by"]
            once = forked(lambda mutant=mutant, tests=tests, cpu_s=cpu_s: _silence(folder) or run_fresh(mutant, tests, cpu_s, folder))
            outcome, by = outcome_of(once)
            row.update(outcome=outcome, by=by, cpu_s=once.cpu_s)
        yield row


def _silence(folder: str) -> None:
    """What is printed goes to a file."""
    said = os.open(f"{folder}/said.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream, target in ((0, os.open(os.devnull, os.O_RDONLY)), (1, said), (2, said)):
        os.dup2(target, stream)


def wilson(killed: int, tried: int) -> tuple[float, float]:
    """The 95 % interval of a share."""
    z, share = 1.96, killed / tried
    middle, half = share + z * z / (2 * tried), z * (share * (1 - share) / tried + z * z / (4 * tried * tried)) ** 0.5
    return (middle - half) / (1 + z * z / tried), (middle + half) / (1 + z * z / tried)


def drawn(part: str, sample: int, seed: int) -> list[Mutant]:
    """`sample` mutants of a part in random order, all where there are fewer."""
    every = [mutant for path in PARTS[part] for mutant in mutants_of(part, path)]
    chosen = random.Random(seed).sample(every, min(sample, len(every)))
    print(f"{part}: {len(every)} mutants, {len(chosen)} drawn", flush=True)
    return chosen


def found_again(part: str, rows: list[dict[str, Any]]) -> list[Mutant]:
    """The mutants of these rows; one whose file has changed since is another, and told to be gone."""
    every = {(mutant.path, mutant.number): mutant for path in PARTS[part] for mutant in mutants_of(part, path)}
    found = []
    for row in [row for row in rows if row["part"] == part]:
        mutant = every.get((row["path"], row["number"]))
        if mutant is None or (mutant.line, mutant.change) != (row["line"], row["change"]):
            print(f"gone: {row['path']}:{row['line']} {row['change']}", flush=True)
        else:
            found.append(mutant)
    return found


def main() -> None:
    """Draw, run, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="plan,io,upload")
    parser.add_argument("--sample", type=int, default=60, help="mutants of each part")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, default=Path("mutants.json"), help="what stands there is not run again")
    parser.add_argument("--again", action="store_true", help="run survivors that stand there once more")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = json.loads(arguments.json.read_text()) if arguments.json.is_file() else []
    left = [row for row in rows if arguments.again and row["outcome"] in ("survived", "undecided")]
    rows = [row for row in rows if row not in left]
    known = {(row["path"], row["number"]) for row in rows}
    # Tests are small: more threads would only wait for each other.
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    preload()
    for part in arguments.parts.split(","):
        chosen = found_again(part, left) if arguments.again else drawn(part, arguments.sample, arguments.seed)
        mutants = [mutant for mutant in chosen if (mutant.path, mutant.number) not in known]
        with tempfile.TemporaryDirectory(prefix="mutants.") as folder:
            for row in rows_of(part, mutants, folder) if mutants else ():
                if row["outcome"] == "reach":
                    print(f"{part}: {row['tests']} tests, traced in {row['cpu_s']:.0f} s of processor time", flush=True)
                    continue
                rows.append({**row, "seed": arguments.seed})
                arguments.json.write_text(json.dumps(rows, indent=1))
                if row["outcome"] in ("survived", "undecided"):
                    print(f"{row['outcome']}: {row['path']}:{row['line']} {row['change']} ({row['tests']} tests)", flush=True)
        tell(part, [row for row in rows if row["part"] == part])


def tell(part: str, rows: list[dict[str, Any]]) -> None:
    """How many of a part's mutants were killed."""
    outcomes = [row["outcome"] for row in rows if row["outcome"] != "undecided"]
    if outcomes:
        killed = len(outcomes) - outcomes.count("survived")
        low, high = (100 * bound for bound in wilson(killed, len(outcomes)))
        cpu_s = sum(row["cpu_s"] for row in rows) / len(rows)
        share = f"{killed} of {len(outcomes)} killed, {100 * killed / len(outcomes):.1f} % [{low:.1f}, {high:.1f}]"
        print(f"{part}: {share}, {len(rows) - len(outcomes)} undecided, {cpu_s:.2f} s of processor time each", flush=True)


if __name__ == "__main__":
    main()
