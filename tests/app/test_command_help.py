"""What `--help` shows first, that its examples can be typed, where old names lead, and what a slip of the keyboard is answered."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from benchmarks.cli import app as benchmarks
from radiant_app.cli.app import app, usage_sentence
from radiant_app.cli.help import MOVED, WIDTH
from radiant_app.config.run_config import FIRST, GROUPS, PLACE
from radiant_core.errors import BadInput
from tests.architecture.test_page_commands import faults

TOP: Any = get_command(app)
BENCH: Any = get_command(benchmarks)


def every_command() -> Iterator[tuple[str, Any]]:
    """Words of a command → the command, those of groups among them; bench passes its words on."""
    for name, command in TOP.commands.items():
        yield name, command
        yield from ((f"{name} {inner}", each) for inner, each in getattr(command, "commands", {}).items())


def shown(*words: str, columns: int = 80) -> str:
    return CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": str(columns), "TERMINAL_WIDTH": str(columns)}).output


def said(*words: str) -> str:
    """What a command line is answered that cannot be run."""
    try:
        app(list(words), prog_name="radiant", standalone_mode=False)
    except typer.TyperException as error:
        return usage_sentence(error)
    except BadInput as error:
        return str(error)
    raise AssertionError(words)


def test_at_most_fifteen_commands_stand_in_groups_and_runs_come_first() -> None:
    assert len(TOP.commands) <= 15 and not MOVED.keys() & TOP.commands.keys()
    text = shown()
    groups = dict(re.findall(r"^([A-Z][\w ]+):\n((?:  .*\n)+)", text, re.MULTILINE))
    assert next(iter(groups)) == "Start here" and groups["Start here"].split()[0] == "run"
    assert "Commands" not in groups and all(f"\n  {name} " in text for name in TOP.commands)
    assert "    radiant run PHOTOS --out RUN\n" in text and "..." not in text.partition("Start here")[2]


@pytest.mark.parametrize("name", [name for name, command in every_command() if not hasattr(command, "commands")])
def test_every_help_has_examples_that_can_be_typed(name: str) -> None:
    command = BENCH if name == "bench" else dict(every_command())[name]
    examples = re.findall(r"^ {4}radiant (.*)$", command.help, re.MULTILINE)
    assert examples and all(example.startswith(name) for example in examples)
    assert [(example, wrong) for example in examples if (wrong := faults(shlex.split(example)))] == []
    assert all(f"\n      radiant {example}\n" in shown(*name.split(), columns=120) for example in examples)


def test_a_run_needs_five_options_and_the_others_stand_by_section() -> None:
    text = shown("run")
    groups = re.findall(r"^([A-Z][\w ,]+):$", text, re.MULTILINE)
    assert groups == ["Arguments", FIRST, GROUPS["sfm"], PLACE, *list(GROUPS.values())[1:]]
    first = text.partition(f"\n{FIRST}:")[2].partition(f"\n{GROUPS['sfm']}:")[0]
    assert re.findall(r"^  (--[\w-]+)", first, re.MULTILINE) == ["--out", "--system", "--frames", "--train-preset", "--resume", "--help"]
    assert len(re.findall(r"^  (?:-v, )?--", text, re.MULTILINE)) == len(TOP.commands["run"].params)  # source out, --help in


@pytest.mark.parametrize("columns", [80, 120])
def test_help_keeps_to_the_width_of_the_terminal(columns: int) -> None:
    wide = [line for name, _ in every_command() if name != "bench" for line in shown(*name.split(), columns=columns).splitlines()]
    assert max(map(len, wide)) <= min(columns, WIDTH["max_content_width"])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("replan plan.json --dead a --json --out new.json", "plan --after plan.json --dead a --json --out new.json"),
        ("replan --dead a --json plan.json --out new.json", "plan --after plan.json --dead a --json --out new.json"),
        ("view RUN --port 80", "inspect --page RUN --port 80"),
        ("change A 'B C' --out D", "measure 'B C' --since A --out D"),
        ("change --out=D A B", "measure B --since A --out=D"),
        ("aggregate RUN --out a.ply --epochs 2", "join RUN --out a.ply --epochs 2"),
        ("extend OLD NEW --out a.ply", "join OLD NEW --out a.ply"),
        ("doctor --photographs 40", "machine check --photographs 40"),
        ("profile --list", "machine profile --list"),
        ("profile --help", "machine profile --help"),
        *((name, None) for name in MOVED),
        *((f"{name} --help", None) for name in MOVED),
    ],
)
def test_an_old_name_answers_the_line_to_type(old: str, new: str | None) -> None:
    name = old.split(maxsplit=1)[0]
    sentence = said(*shlex.split(old))
    start = f"`radiant {name}` is now `radiant {MOVED[name].to}`: type `radiant "
    assert sentence.startswith(start) and sentence.endswith("`.") and "\n" not in sentence
    line = sentence.removeprefix(start).removesuffix("`.")
    assert new in (None, line)
    assert faults(shlex.split(line)) == [] and (line.endswith("--help") or not faults(MOVED[name].to.split()))


@pytest.mark.parametrize(
    ("typed", "sentence"),
    [
        ("rn x", "No such command 'rn'. Did you mean 'run'? `radiant --help` lists what there is."),
        ("node jion x", "No such command 'jion'. Did you mean 'join'? `radiant node --help` lists what there is."),
        ("run x --otu y", "`radiant run` has no option --otu: did you mean --out? `radiant run --help` lists what there is."),
        ("machine check --qqqq", "`radiant machine check` has no option --qqqq: `radiant machine check --help` lists what there is."),
        ("run x --out y --set train.num_stps=3", "--set 'train.num_stps=3' sets nothing: did you mean train.num_steps?"),
        ("run x --out y --set max-splats=300", "--set 'max-splats=300' sets nothing: did you mean train.max_num_splats?"),
        ("run x --out y --set train.seed=3", "--set 'train.seed=3' sets nothing: use seed."),
        ("train", "Missing argument 'SCENE': `radiant train --help` lists what there is."),
        ("render m.ply", "name one place to write, a .png, a film or a new folder: radiant render MODEL OUT."),
        ("render m.ply a.png --out b.png", "name one place to write, a .png, a film or a new folder: radiant render MODEL OUT."),
        (
            "plan --out p.json",
            "source is missing: name waypoints, photographs, a scene or a run; or --after and a plan or run.",
        ),
        ("plan a --photographs 3 --out c", "--photographs is for the next flight: name a finished run with --next."),
        ("plan --next a --slack 2 --out c", "--slack is for a new plan, and --next keeps to the run that there is: leave one of them out."),
        ("plan --next a --after b --out c", "--after plans again and --next plans another flight: ask for one of them."),
        ("plan a --dead b --out c.json", "--dead is for planning again: name the plan or run with --after."),
        ("plan a --after b --out c.json", "--after plans b again, and a is another source: leave one of them out."),
        (
            "plan --after b --slack 2 --out c.json",
            "--slack is for a new plan, and --after keeps to the plan that there is: leave one of them out.",
        ),
        ("measure r --out d", "--out is for change between two dates: name the earlier run with --since."),
        ("measure r --since a", "--out is missing: name a new folder for what has changed."),
        (
            "measure r --since a --out d --kind area",
            "--since is for change between two dates and --kind for a measure: leave one of them out.",
        ),
        ("join r --out j.ply --margin-m 3", "--margin-m is of a new region: name the run of that region too, radiant join RUN NEW."),
        (
            "join r n --out j.ply --aggregate-preset paper",
            "--aggregate-preset is for joining one run again, and n is a second: leave one of them out.",
        ),
        ("inspect r --web --page", "--web serves the inspector and --page the model alone: ask for one of them."),
        ("inspect r --page --host 0.0.0.0", "--page serves a page, and --host is for something else: leave one of them out."),
        ("inspect r --web --view seams", "--web serves a page, and --view is for something else: leave one of them out."),
        ("inspect r --port 80", "--port is for a page in a browser: add --web or --page, or leave it out."),
    ],
)
def test_a_slip_is_answered_with_what_was_meant(typed: str, sentence: str) -> None:
    assert said(*typed.split()) == sentence
