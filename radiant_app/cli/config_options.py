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
    mark = field.option
    default_text = mark.default_text if mark.default_text is not None and mark.parse is None else True
    names = names or (field.option_name,)
    group = group or mark.group or GROUPS[path.rpartition(".")[0]]
    return typer.Option(
        *names,
        help=help or field.help,
        min=mark.min,
        max=mark.max,
        metavar=mark.metavar,
        show_default=default_text,
        rich_help_panel=None if group == FIRST else group,
    )


def with_config_options(command: Callable[..., None]) -> Callable[..., None]:
    """`command` with an option per field of `RunConfig` in place of its `**`; see
    `given_values`."""
    parameters = _named_parameters(command)
    required = [parameter for parameter in parameters if parameter.default is parameter.empty]
    of_config = [_parameter(field) for field in config_fields().values() if field.option is not None and field.path != "source"]
    ordered = (*required, *of_config, *parameters[len(required) :])
    return _with_parameters(command, [parameter.replace(kind=parameter.KEYWORD_ONLY) for parameter in ordered])


def with_options_of(*others: Callable[..., None]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Puts the options of `others` that are not keywords alone in place of a command's `**`."""

    def with_them(command: Callable[..., None]) -> Callable[..., None]:
        more = [parameter.replace(kind=parameter.KEYWORD_ONLY) for part in others for parameter in options_of(part)]
        return _with_parameters(command, [*_named_parameters(command), *more])

    return with_them


def options_of(command: Callable[..., None]) -> list[inspect.Parameter]:
    """The options of a command's part that are its alone: those that are not keywords alone."""
    parameters = inspect.signature(command, eval_str=True).parameters.values()
    return [parameter for parameter in parameters if parameter.kind is not parameter.KEYWORD_ONLY]


def _named_parameters(command: Callable[..., None]) -> list[inspect.Parameter]:
    """Those of a command but its `**`."""
    parameters = inspect.signature(command, eval_str=True).parameters.values()
    return [parameter for parameter in parameters if parameter.kind is not parameter.VAR_KEYWORD]


def _with_parameters(command: Callable[..., None], parameters: Sequence[inspect.Parameter]) -> Callable[..., None]:
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def given_values(context: typer.Context) -> dict[str, Any]:
    """Path → value of the fields whose options somebody typed."""
    typed = {name: value for name, value in context.params.items() if name != "source" and _was_typed(context, name)}
    return {field.path: field.of_option(typed[_name(field)]) for field in config_fields().values() if _name(field) in typed}


def typed_options(context: typer.Context) -> dict[str, str]:
    """Parameter → option of all that somebody typed."""
    return {
        parameter.name: parameter.opts[0] for parameter in context.command.params if parameter.name and _was_typed(context, parameter.name)
    }


def _was_typed(context: typer.Context, name: str) -> bool:
    return str(context.get_parameter_source(name)).endswith("COMMANDLINE")


def _name(field: ConfigField) -> str:
    return field.path.replace(".", "__")


def _parameter(field: ConfigField) -> inspect.Parameter:
    kind, default, text = field.kind, field.default, None
    of_paper = RUN_PRESETS["paper"].get(field.path)
    if field.option is not None and field.option.parse is not None:
        kind, default = str, field.option.default_text
    elif of_paper is not None:
        text = f"{field.help}  [default: {field.default}; paper: {of_paper}]"
        kind, default = kind | None, None
    elif field.path == "out":
        kind, default = kind | None, None
    annotation = Annotated[kind, option(field.path, help=text)]
    return inspect.Parameter(_name(field), inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
