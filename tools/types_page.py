"""Write docs/types.md: the types that flow from one package to another, read from the source.

A type is listed where it is a frozen dataclass with keyword-only fields, or a protocol, and a module
of another room imports it. `python tools/types_page.py` writes the page (`make docs` does so too).
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/types.md"
PACKAGES = {
    "radiant_core": ROOT / "core/radiant_core",
    "radiant_viewer": ROOT / "viewer/radiant_viewer",
    "radiant_app": ROOT / "radiant_app",
    "radiant": ROOT / "radiant",
}
ORDER = ("core", "viewer", "app", "radiant")
MOST_ROOMS = 6
HEAD = """# What flows: the types

Generated from the source by `python tools/types_page.py`: frozen dataclasses with keyword-only fields,
checked when they are constructed, and protocols, where another room imports them. Arrays are numpy at
every border between packages; torch stays inside `render`, `train`, `aggregate` and `evaluate`. Letters
in shapes: C cameras, N Gaussians, P points, E edges, D devices, V views, M models, K harmonic bases,
H × W pixels. The words are in the [glossary](glossary.md).
"""


def modules() -> Iterator[tuple[str, Path]]:
    """Dotted name and file of every module."""
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            yield ".".join((package, *(part for part in parts if part != "__init__"))), path


def room(module: str) -> str:
    """The room of a module as ARCHITECTURE.md names it: core/plan, app/run, core for the root."""
    package, *parts = module.split(".")
    short = package.removeprefix("radiant_")
    return f"{short}/{parts[0]}" if len(parts) > 1 else short


def flows(node: ast.ClassDef) -> bool:
    """Whether a class is a frozen dataclass with keyword-only fields or a protocol."""
    decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
    frozen = any("frozen=True" in text and "kw_only=True" in text for text in decorators)
    return not node.name.startswith("_") and (frozen or any(ast.unparse(base) == "Protocol" for base in node.bases))


def first_sentence(node: ast.ClassDef) -> str:
    """What a class says of itself, up to its first full stop."""
    paragraph = " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
    return paragraph.split(". ")[0].rstrip(".").replace("|", "\\|")


def users_of(rooms: set[str]) -> str:
    """The rooms by name, or their packages where they are many."""
    return ", ".join(sorted(rooms if len(rooms) <= MOST_ROOMS else {f"{name.split('/')[0]}/…" for name in rooms}))


def page() -> str:
    """The text of docs/types.md."""
    trees = {module: (path, ast.parse(path.read_text())) for module, path in modules()}
    users: dict[tuple[str, str], set[str]] = defaultdict(set)
    for module, (_path, tree) in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in trees and room(node.module) != room(module):
                for alias in node.names:
                    users[node.module, alias.name].add(room(module))
    rows: dict[str, list[str]] = defaultdict(list)
    for module, (path, tree) in trees.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and flows(node) and (by := users[module, node.name]):
                where = path.relative_to(ROOT).as_posix()
                rows[room(module)].append(f"| `{node.name}` | `{where}` | {first_sentence(node)} | {users_of(by)} |")
    named = sorted(rows.items(), key=lambda item: (ORDER.index(item[0].split("/")[0]), item[0]))
    tables = ("\n".join([f"## {name}", "| type | module | what it is | used by |", "|---|---|---|---|", *lines]) for name, lines in named)
    return "\n\n".join([HEAD.strip(), *tables]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
