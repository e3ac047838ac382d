"""The command `radiant`; commands import heavy libraries themselves, so that `--help` is quick."""

from __future__ import annotations

import atexit
import gc
import importlib
import sys
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from radiant_app.cli.help import WIDTH, Command, Commands
from radiant_app.cli.inspect import inspect
from radiant_app.cli.machine import machine
from radiant_app.cli.models import clean, evaluate, export, render
from radiant_app.cli.node import node
from radiant_app.cli.parts import join, sfm, train
from radiant_app.cli.plan import plan
from radiant_app.cli.run import demo, run
from radiant_app.cli.streams import CannotPrint, make_streams_last
from radiant_app.cli.survey import measure
from radiant_app.interrupts import INTERRUPTED, interrupt_on_signals, stop_repeating_interrupt
from radiant_app.plain_text import shown_text
from radiant_app.workers.memory import OUT_OF_MEMORY, is_out_of_memory
from radiant_core import __version__
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed, way_to_write

app = typer.Typer(
    cls=Commands,
    help="""Turn photographs of a large scene into one 3D Gaussian model, over unequal machines.

    radiant demo
    radiant run PHOTOS --out RUN
    radiant inspect RUN
    """,
    context_settings=WIDTH,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_START, _MACHINES, _PARTS, _MODELS, _SOURCE = "Start here", "Plan and machines", "Parts of a run", "Finished models", "Development"


def _print_version(is_typed: bool) -> None:
    if is_typed:
        typer.echo(f"radiant {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")] = False,
) -> None:
    pass


for _command in (run, inspect, demo):
    app.command(cls=Command, rich_help_panel=_START)(_command)
app.command(cls=Command, rich_help_panel=_MACHINES)(plan)
app.add_typer(machine, name="machine", rich_help_panel=_MACHINES)
app.add_typer(node, name="node", rich_help_panel=_MACHINES)
for _command in (sfm, train, join):
    app.command(cls=Command, rich_help_panel=_PARTS)(_command)
for _command in (render, export, evaluate, clean, measure):
    app.command(cls=Command, rich_help_panel=_MODELS)(_command)


@app.command(rich_help_panel=_SOURCE, context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []})
def bench(context: typer.Context) -> None:
    """Run the benchmarks of the source (benchmarks/README.md)."""
    source = Path(__file__).resolve().parents[2]
    if not (source / "benchmarks" / "cli.py").is_file():
        raise BadInput(
            "the benchmarks are in the source and no part of this installation: "
            "clone the repository, run ./setup.sh there and use its .venv/bin/radiant."
        )
    if str(source) not in sys.path:
        sys.path.append(str(source))
    code = importlib.import_module("benchmarks.cli").main(context.args)
    if code:
        raise typer.Exit(int(code))


def main() -> NoReturn:
    """Entry point: one sentence for what a user can mend; exit code 2: bad input, 130: Ctrl-C."""
    make_streams_last()
    interrupt_on_signals()
    # Memory goes with the process: what collects it before takes half a second of CPU time.
    atexit.register(gc.freeze)
    try:
        _require_working_folder()
        code = app(sys.argv[1:] or ["--help"], prog_name="radiant", standalone_mode=False)
    except RadiantError as error:
        _say(f"{error} {_how_to_go_on()}".strip() if isinstance(error, CannotWrite) else str(error))
        sys.exit(error.exit_code)
    except (MemoryError, RuntimeError) as error:
        if str(error).startswith("Symlink loop"):  # of pathlib before Python 3.13
            _say(f"{error}: links that lead to each other name no file, give another path.")
            sys.exit(BadInput.exit_code)
        if not is_out_of_memory(error):
            raise
        _say(f"{OUT_OF_MEMORY} {_how_to_go_on()}".strip())
        sys.exit(StageFailed.exit_code)
    except CannotPrint as error:
        _say(f"the result could not be printed ({error.strerror}): {_where_it_lies(error)}.")
        sys.exit(BadInput.exit_code)
    except OSError as error:
        _say(f"{error.strerror or error} ({error.filename}): {way_to_write(error, 'free space there', 'check the path and the rights')}.")
        sys.exit(BadInput.exit_code)
    except typer.TyperException as error:
        _say(usage_sentence(error))
        sys.exit(BadInput.exit_code)
    stop_repeating_interrupt()
    if code == INTERRUPTED:
        _say(f"interrupted. {_how_to_go_on()}".strip())
    sys.exit(code if isinstance(code, int) else 0)


def usage_sentence(error: typer.TyperException) -> str:
    """What is wrong with a command line, the option that was probably meant, and whose help lists
    what there is."""
    context: Any = getattr(error, "ctx", None)
    command = "radiant" if context is None else context.command_path
    helped = f"`{command} --help` lists what there is."
    if (mistyped := getattr(error, "option_name", None)) is not None:
        near = (getattr(error, "possibilities", None) or [])[:1]
        return f"`{command}` has no option {mistyped}: {f'did you mean {near[0]}? ' if near else ''}{helped}"
    message = error.format_message()
    return f"{message} {helped}" if message.endswith("?") else f"{message.rstrip('.')}: {helped}"


def _require_working_folder() -> None:
    """Raise BadInput where the working folder is gone: libraries fail there in obscure ways."""
    try:
        Path.cwd()
    except FileNotFoundError:
        raise BadInput("the folder that this was started in does not exist any more: change to one that does.") from None


def _how_to_go_on() -> str:
    resumable = set(sys.argv[1:2]) & {"run", "demo", "train", "sfm"}
    return "Finished work is kept: repeat the command with --resume." if resumable else ""


def _where_it_lies(error: CannotPrint) -> str:
    out_paths = [after for option, after in pairwise(sys.argv) if option == "--out"]
    out_paths += [argument.removeprefix("--out=") for argument in sys.argv if argument.startswith("--out=")]
    existing = [out for out in out_paths if Path(out).exists()]
    return (
        f"it lies in {existing[0]}"
        if existing
        else way_to_write(error, "send standard output elsewhere, or free space there", "send standard output elsewhere")
    )


def _say(message: str) -> None:
    typer.echo(f"radiant: {shown_text(message)}", err=True)


if __name__ == "__main__":
    main()
