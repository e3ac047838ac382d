"""Few names are determiners or participles, which do not say what a thing is.

By hand, `python tests/architecture/test_names.py [FOLDER ...]` prints the counts and every place.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PACKAGES = ("core/radiant_core", "viewer/radiant_viewer", "radiant_app", "radiant")
LISTED = (
    "own found kept known given taken made done seen left held shown drawn said told read laid rest each other same such"
    " beside which whose what this that these those asked"
)
WORDS = frozenset(LISTED.split())
MAX_SHARE = 0.005
NUM_WORST = 20


class Place(NamedTuple):
    """A name where it is assigned."""

    source: str
    line: int
    name: str

    @property
    def is_bare(self) -> bool:
        """Whether the whole name, without underscores around it, is one of the words."""
        return self.name.strip("_").lower() in WORDS


def assigned_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Lines and names of variables, arguments, functions, classes and attributes of class bodies."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield node.lineno, name
            case ast.ClassDef(name=name) | ast.arg(arg=name):
                yield node.lineno, name
            case (
                ast.ExceptHandler(name=str(name))
                | ast.MatchAs(name=str(name))
                | ast.MatchStar(name=str(name))
                | ast.MatchMapping(rest=str(name))
            ):
                yield node.lineno, name
            case _:
                pass


def places(folders: Iterable[Path]) -> list[Place]:
    """Every name that the Python files of the folders assign."""
    return [
        Place(source.relative_to(ROOT).as_posix(), line, name)
        for folder in folders
        for source in sorted(folder.rglob("*.py"))
        for line, name in assigned_names(ast.parse(source.read_text()))
    ]


def report(names: list[Place]) -> str:
    """The share of bare names, the commonest of them and the files with the most."""
    bare = [place for place in names if place.is_bare]
    words = ", ".join(f"{name} {count}" for name, count in Counter(place.name for place in bare).most_common(NUM_WORST))
    files = Counter(place.source for place in bare).most_common(NUM_WORST)
    worst = [
        f"{count:5}  {source}: " + ", ".join(f"{place.name} ({place.line})" for place in bare if place.source == source)
        for source, count in files
    ]
    share = len(bare) / max(1, len(names))
    return "\n".join(
        [f"{len(bare)} of {len(names)} names ({share:.2%}; at most {MAX_SHARE:.1%}) do not say what they are: {words}", *worst]
    )


def test_names_say_what_things_are() -> None:
    names = places(ROOT / package for package in PACKAGES)
    assert {Path(place.source).parts[0] for place in names} == {Path(package).parts[0] for package in PACKAGES}
    num_bare = sum(place.is_bare for place in names)
    assert num_bare <= MAX_SHARE * len(names), report(names)


def test_every_way_to_assign_a_name_is_counted() -> None:
    source = """
class Known(Base):
    kept = 1
    seen: int
    def read(self, given, /, told, *, own, **rest):
        left, (held, *shown) = given
        with held as taken: self.not_counted = drawn
        for each in taken: done = lambda said: [same for same in (made := each)]
async def which(*those): pass
try: ...
except Error as that: ...
match value:
    case [what, *other]: ...
    case {"key": this, **beside}: ...
"""
    counted = sorted(name for _, name in assigned_names(ast.parse(source)))
    expected = (
        "Known kept seen read self given told own rest left held shown taken each done said same made which those that what other"
        " this beside"
    )
    assert counted == sorted(expected.split())
    assert sum(Place("file", 1, name).is_bare for name in counted) == len(counted) - 1
    assert Place("file", 1, "_KEPT").is_bare
    assert not Place("file", 1, "kept_rows").is_bare


ANSWERS = {
    "is": r"bool|np\.ndarray|NDArray\[np\.bool_\]|TypeGuard\[.*\]",
    "has": r"bool|bool \| None",
    "num": r"int|int \| None|float",
}
"""First word of a function's name → what it returns, as docs/glossary.md says of verbs."""


def verbs_that_lie(source: str) -> list[str]:
    """Functions that are called like a question and answer with something else."""
    lies = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and node.returns is not None:
            pattern, answer = ANSWERS.get(node.name.lstrip("_").partition("_")[0]), ast.unparse(node.returns)
            if pattern is not None and not re.fullmatch(pattern, answer):
                lies.append(f"{node.name} answers {answer}")
    return lies


def test_a_function_that_is_called_like_a_question_answers_it() -> None:
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    assert [f"{file.name}: {lie}" for file in files for lie in verbs_that_lie(file.read_text())] == []
    assert verbs_that_lie("def is_late(): ...\ndef has_it() -> bool: ...\ndef _num_of() -> str: ...") == ["_num_of answers str"]


def main() -> None:
    """Print the counts of the packages, or of the folders named, and every place of a bare name."""
    names = places([Path(folder).resolve() for folder in sys.argv[1:]] or [ROOT / package for package in PACKAGES])
    for place in names:
        if place.is_bare:
            print(f"{place.source}:{place.line} {place.name}")
    print(report(names))


if __name__ == "__main__":
    main()
