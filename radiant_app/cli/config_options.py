"""Options made from the fields of `RunConfig`, so that each is declared once, there."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from radiant_app.config.fields import ConfigField, config_fields
from radiant_app.config.run_config import FIRST, GROUPS, RUN_PRESETS


def option(
    path: str,
    *names: str,
    help: str | None = None,  # noqa: A002
    group: str | None = None,
) -> Any:
    """Typer's description of a field's option, with other `names`, `help` or `group` where it means
    more."""
    field = config_fields()[path]
    assert field.option is not None
    known = field.option
    shown = known.shown if known.shown is not None and known.parse is None else True
    names = names or (field.option_name,)
    group = group or known.group or GROUPS[path.rpartition(".")[0]]
    return typer.Option(
        *names,
        help=help or field.help,
        min=known.min,
        max=known.max,
        metavar=known.metavar,
        show_default=shown,
        rich_help_panel=None if group == FIRST else group,
    )


def with_config_options(command: Callable[..., None]) -> Callable[..., None]:
    """`command` with an option per field of `RunConfig` in place of its `**`; see
    `given_values`."""
    own = [each for each in inspect.signature(command, eval_str=True).parameters.values() if each.kind is not each.VAR_KEYWORD]
    first = [each for each in own if each.default is each.empty]
    made = [_parameter(field) for field in config_fields().values() if field.option is not None and field.path != "source"]
    return _with_parameters(command, [each.replace(kind=each.KEYWORD_ONLY) for each in (*first, *made, *own[len(first) :])])


def with_options_of(*others: Callable[..., None]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Puts the options of `others` that are not keywords alone in place of a command's `**`."""

    def with_them(command: Callable[..., None]) -> Callable[..., None]:
        own = [each for each in inspect.signature(command, eval_str=True).parameters.values() if each.kind is not each.VAR_KEYWORD]
        more = [each.replace(kind=each.KEYWORD_ONLY) for other in others for each in options_of(other)]
        return _with_parameters(command, [*own, *more])

    return with_them


def options_of(command: Callable[..., None]) -> list[inspect.Parameter]:
    """The options of a command's part that are its alone: those that are not keywords alone."""
    return [each for each in inspect.signature(command, eval_str=True).parameters.values() if each.kind is not each.KEYWORD_ONLY]


def _with_parameters(command: Callable[..., None], parameters: Sequence[inspect.Parameter]) -> Callable[..., None]:
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    return command


def given_values(context: typer.Context) -> dict[str, Any]:
    """Path → value of the fields whose options somebody typed."""
    typed = {name: value for name, value in context.params.items() if name != "source" and _was_typed(context, name)}
    return {field.path: field.of_option(typed[_name(field)]) for field in config_fields().values() if _name(field) in typed}


def typed_options(context: typer.Context) -> dict[str, str]:
    """Parameter → option of all that somebody typed."""
    return {each.name: each.opts[0] for each in context.command.params if each.name and _was_typed(context, each.name)}


def _was_typed(context: typer.Context, name: str) -> bool:
    return str(context.get_parameter_source(name)).endswith("COMMANDLINE")


def _name(field: ConfigField) -> str:
    return field.path.replace(".", "__")


def _parameter(field: ConfigField) -> inspect.Parameter:
    kind, default, text = field.kind, field.default, None
    of_paper = RUN_PRESETS["paper"].get(field.path)
    if field.option is not None and field.option.parse is not None:
        kind, default = str, field.option.shown
    elif of_paper is not None:
        text = f"{field.help}  [default: {field.default}; paper: {of_paper}]"
        kind, default = kind | None, None
    elif field.path == "out":
        kind, default = kind | None, None
    annotation = Annotated[kind, option(field.path, help=text)]
    return inspect.Parameter(_name(field), inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
