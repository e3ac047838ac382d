"""How `--help` reads: commands and options in groups, the essential ones first, then examples as
they are typed; and what an old name of a command answers."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import cleandoc
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from radiant_app.config.run_config import FIRST, GROUPS, PLACE
from radiant_core.errors import BadInput

WIDTH = {"max_content_width": 100}
"""Settings of the command line: columns of its help where the terminal is wider."""
_OTHERS = ""
_ORDER = [FIRST, _OTHERS, GROUPS["sfm"], PLACE, *list(GROUPS.values())[1:]]
"""Groups of options from first to last; `_OTHERS` are those that are not named here."""
_SHORT_TYPES = {"<path>": "PATH", "<str>": "TEXT", "<int>": "N", "<int range>": "N", "<float>": "X", "<float range>": "X"}
_SHORT_TYPES |= {f"<list[{kind}]>": short for kind, short in (("Path", "PATH"), ("str", "TEXT"), ("int", "N"), ("float", "X"))}


class Command(TyperCommand):
    """A command whose options stand in groups; lines of its text that begin with its program are
    examples."""

    def __init__(self, *names: Any, **settings: Any) -> None:
        super().__init__(*names, **settings)
        self.help = _with_examples(self.help)
        self.params.sort(key=lambda param: _ORDER.index(group) if (group := _group_of(param)) in _ORDER else _ORDER.index(_OTHERS))
        for param in self.params:
            _shorten(param)

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """The text, with examples line by line."""
        _write_text(self, formatter)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Arguments, then the options, group by group."""
        _write_groups(self, ctx, formatter)


class Commands(TyperGroup):
    """Commands in groups; an old name answers where its command went."""

    def __init__(self, *names: Any, **settings: Any) -> None:
        super().__init__(*names, **settings)
        self.help = _with_examples(self.help)

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """As of a command."""
        _write_text(self, formatter)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """The commands, group by group, then the options."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            group = getattr(command, "rich_help_panel", None)
            groups.setdefault(group if isinstance(group, str) else "Commands", []).append((name, command.get_short_help_str(200)))
        width = max(len(name) for name in self.commands)
        for group, rows in groups.items():
            with formatter.section(group):
                formatter.write_dl([(name.ljust(width), text) for name, text in rows])
        _write_groups(self, ctx, formatter)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command; BadInput says where one went that had another name."""
        if not args or args[0] in self.commands or ctx.parent is not None or args[0] not in MOVED:
            return super().resolve_command(ctx, args)
        raise BadInput(MOVED[args[0]].sentence(args[0], args[1:]))


@dataclass(frozen=True, kw_only=True)
class Moved:
    """Where a command went."""

    to: str
    """The command that does it now, in words for "is now"."""
    line: Callable[[Sequence[str]], Sequence[str]]
    """The new words for the words that were typed behind the old name."""
    example: str
    """The words behind the old name, where none were typed."""

    def sentence(self, name: str, typed: Sequence[str]) -> str:
        """What the old name answers."""
        command = [word for word in self.to.split() if not word.startswith("-")]
        new = [*command, "--help"] if "--help" in typed else self.line(typed or self.example.split())
        return f"`radiant {name}` is now `radiant {self.to}`: type `{shlex.join(['radiant', *new])}`."


def _behind(*words: str) -> Callable[[Sequence[str]], Sequence[str]]:
    """The new words before all that was typed."""
    return lambda typed: [*words, *typed]


def _after(typed: Sequence[str]) -> list[str]:
    named, others = _divided(typed, 1)
    return ["plan", "--after", *(named or ["PLAN.json"]), *others]


def _since(typed: Sequence[str]) -> list[str]:
    named, others = _divided(typed, 2)
    older, newer = (*named, "EARLIER", "LATER")[:2] if len(named) != 1 else (named[0], "LATER")
    return ["measure", newer, "--since", older, *others]


def _divided(typed: Sequence[str], num_arguments: int) -> tuple[list[str], list[str]]:
    """The first arguments, and all else; --json alone of these commands' options has no value."""
    takes_value = [word.startswith("-") and "=" not in word and word != "--json" for word in typed]
    arguments = [at for at, word in enumerate(typed) if not word.startswith("-") and not (at and takes_value[at - 1])][:num_arguments]
    return [typed[at] for at in arguments], [word for at, word in enumerate(typed) if at not in arguments]


MOVED = {
    "replan": Moved(to="plan --after", line=_after, example="PLAN.json --dead ID --out NEW.json"),
    "view": Moved(to="inspect --page", line=_behind("inspect", "--page"), example="RUN"),
    "change": Moved(to="measure --since", line=_since, example="EARLIER LATER --out FOLDER"),
    "aggregate": Moved(to="join", line=_behind("join"), example="RUN --out JOINED.ply"),
    "extend": Moved(to="join", line=_behind("join"), example="OLD NEW --out LARGER.ply"),
    "doctor": Moved(to="machine check", line=_behind("machine", "check"), example=""),
    "profile": Moved(to="machine profile", line=_behind("machine", "profile"), example="--out MACHINE.toml"),
}
"""Old name → where its command went."""


def _write_groups(command: Any, ctx: Any, formatter: Any) -> None:
    groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], FIRST: []}
    for param in command.get_params(ctx):
        if (row := param.get_help_record(ctx)) is not None:
            groups.setdefault("Arguments" if param.param_type_name == "argument" else _group_of(param), []).append(row)
    for group, rows in groups.items():
        if rows:
            with formatter.section(group):
                formatter.write_dl(rows, col_max=26)


def _group_of(param: Any) -> str:
    group = getattr(param, "rich_help_panel", None)
    return group if isinstance(group, str) else FIRST


def _shorten(param: Any) -> None:
    """Name what an option takes in one capital word, and an argument as the prose does."""
    if param.metavar is None and isinstance(param, TyperOption) and not param.is_flag:
        param.metavar = _SHORT_TYPES.get(param.display_type(typer.Context(TyperCommand("radiant"))))
    elif param.metavar is None and not isinstance(param, TyperOption):
        param.metavar = param.name.upper()


def _with_examples(text: str | None) -> str:
    return re.sub(r"^ *(?=radiant )", "    ", cleandoc(text or ""), flags=re.MULTILINE)


def _write_text(command: Any, formatter: Any) -> None:
    """The text of the command; what stands indented there is not wrapped."""
    formatter.write_paragraph()
    with formatter.indentation():
        formatter.write_text(re.sub(r"\n\n(?= {4})", "\n\n\b\n", command.help or ""))
