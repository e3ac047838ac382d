"""The fields of `RunConfig` by dotted path (train.num_steps), for options, files and manifests.

    values of paths  ─config_of→  RunConfig  ─tables_of→  tables of a run file  ─values_of→  values

Fields of `TrainConfig`, of both joins of `AggregateConfig` and of `Refine` belong to the sections
train, aggregate and refine, where they are settings beside a preset.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from radiant_app.config import run_config as config_module
from radiant_app.config.paths import path_of_text
from radiant_app.config.run_config import RUN_PRESETS, Option, PlanOptions, RunConfig, RunPreset, SettingsOf, TrainOptions
from radiant_core.errors import BadInput

PRESET = "preset"
"""Not a field of `RunConfig`: a name for the values of several."""
_OF_BOTH = ("max_num_steps", "retrain_single", "foreign_opacity", "faint_opacity", "agreement_db", "weight_by_alpha")
NEW_PATHS = {
    "aggregate.refine_epochs": "refine.epochs",
    "aggregate.refine_rounds": "refine.rounds",
    "aggregate.edge_epochs": "aggregate.edge.epochs",
    "aggregate.cloud_epochs": "aggregate.cloud.epochs",
    "aggregate.cloud": "aggregate.cloud.method",
    **{f"aggregate.{name}": f"aggregate.edge.{name} and aggregate.cloud.{name}" for name in _OF_BOTH},
}
"""Earlier path of a field → where it is now."""
_PRESET_HELP = (
    "paper: everything as in the paper, nothing skipped or reduced: Alg. 1 and RTP, 20,000 steps with densification, edges and cloud "
    "retrain all parameters for 10 epochs, crop-merge only beyond the limits of [cloud] in the system file. An option beside it wins."
)


@dataclass(frozen=True, kw_only=True)
class ConfigField:
    """One value that a user can give."""

    path: str
    kind: Any
    """Its type."""
    default: Any = None
    help: str = ""
    option: Option | None = None
    """None: it has no option of its own and is set by `--set`."""

    @property
    def option_name(self) -> str:
        """What the command line calls it."""
        leaf = self.path.rpartition(".")[2].replace("_", "-")
        return f"--set {self.path}" if self.option is None else self.option.name or f"--{leaf}"

    @property
    def typed_name(self) -> str:
        """The option's name as a key would have it."""
        return self.option_name.rpartition(" ")[2].lstrip("-").replace("-", "_")

    @property
    def is_path(self) -> bool:
        """Whether it names a file or folder."""
        return Path in (self.kind, *get_args(self.kind))

    @property
    def checked_kind(self) -> Any:
        """Its type with its limits, for pydantic; a path is text."""
        from pydantic import Field

        text: Any = Annotated[str, Field(min_length=1)]
        kind = self.kind if not self.is_path else text | None if type(None) in get_args(self.kind) else text
        return kind if self.option is None else Annotated[kind, Field(ge=self.option.min, le=self.option.max)]

    @property
    def typed_kind(self) -> Any:
        """The type of its option's value, as a job file has it too."""
        return str if self.option is not None and self.option.parse is not None else self.checked_kind

    def of_option(self, value: Any) -> Any:
        """The value of an option of that type."""
        if self.is_path:
            return path_of_text(str(value), self.option_name)
        return self.option.parse(value) if self.option is not None and self.option.parse is not None else value

    def parse_value(self, value: Any, kind: str | None = None) -> Any:
        """The value in a `kind` of file, or the text given to `--set`; "none" is None. BadInput
        names the place and what is expected."""
        from pydantic import ConfigDict, TypeAdapter, ValidationError

        if isinstance(value, str) and value.strip().lower() == "none" and type(None) in get_args(self.kind):
            return None
        adapter = TypeAdapter(self.checked_kind, config=ConfigDict(strict=True, allow_inf_nan=False))
        try:
            checked = adapter.validate_strings(value.strip(), strict=False) if kind is None else adapter.validate_python(value)
        except ValidationError as error:
            from radiant_core.io.strict import problem_sentence
            from radiant_core.train.config import what_was_expected

            typed = f"--set '{self.path}={value}': {what_was_expected(error)}."
            raise BadInput(typed if kind is None else problem_sentence(error, kind, self.path)) from error
        return checked if checked is None or not self.is_path else path_of_text(checked, self.path)


@cache
def config_fields() -> dict[str, ConfigField]:
    """Path → field of everything that a run can be asked for, in the order of the options."""
    preset = ConfigField(path=PRESET, kind=RunPreset, default="default", help=_PRESET_HELP, option=Option())
    return {field.path: field for field in (*_fields_of(RunConfig), preset)}


def _fields_of(config: type, prefix: str = "") -> Iterator[ConfigField]:
    hints = get_type_hints(config, include_extras=True)
    for field in fields(config):
        path, hint = f"{prefix}{field.name}", hints[field.name]
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        mark = marks[0] if marks else Option()
        if isinstance(mark, SettingsOf):
            yield from (ConfigField(path=f"{prefix}{name}", kind=kind) for name, kind in mark.types().items() if name not in mark.fixed)
        elif isinstance(kind, type) and is_dataclass(kind):
            yield from _fields_of(kind, f"{path}.")
        else:
            yield ConfigField(
                path=path, kind=kind, default=field.default, help=_sentences_under_fields()[f"{config.__name__}.{field.name}"], option=mark
            )


@cache
def _sentences_under_fields() -> dict[str, str]:
    """Class.field of `run_config` → the text under it in the source, on one line."""
    classes = [node for node in ast.parse(inspect.getsource(config_module)).body if isinstance(node, ast.ClassDef)]
    return {
        f"{defined.name}.{field.target.id}": " ".join(text.value.value.split())
        for defined in classes
        for field, text in pairwise(defined.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    }


def config_of(values: Mapping[str, Any]) -> RunConfig:
    """The run that values of paths ask for, of which one beside a preset wins over it; BadInput
    where a value is missing, wrong, or contradicts another."""
    values_by_path = dict(values)
    preset = values_by_path.pop(PRESET, "default")
    if preset not in RUN_PRESETS:
        raise BadInput(f"preset {preset!r} is unknown: use one of {', '.join(get_args(RunPreset))}.")
    if "out" not in values_by_path:
        raise BadInput("--out is missing: name the run's folder.")
    if "source" not in values_by_path:
        raise BadInput("source is missing: name the photographs.")
    of_preset = {
        path: value for path, value in RUN_PRESETS[preset].items() if path != "plan.method" or values_by_path.get("plan.file") is None
    }
    return RunConfig(**_arguments({**of_preset, **values_by_path}))


def train_options(values: Mapping[str, Any]) -> TrainOptions:
    """The training that values of paths in the section train ask for; BadInput as `config_of`."""
    return _arguments(values)["train"]


def plan_options(values: Mapping[str, Any]) -> PlanOptions:
    """The plan that values of paths in the section plan ask for; BadInput as `config_of`."""
    return _arguments(values)["plan"]


def _arguments(values: Mapping[str, Any]) -> dict[str, Any]:
    arguments: dict[str, Any] = {}
    sections: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        section, dot, name = path.partition(".")
        if not dot:
            arguments[path] = value
        elif config_fields()[path].option is not None:
            sections.setdefault(section, {})[name] = value
        else:
            sections.setdefault(section, {}).setdefault("settings", {})[name] = value
    kinds = get_type_hints(RunConfig)
    return arguments | {section: kinds[section](**values_of_section) for section, values_of_section in sections.items()}


def tables_of(config: Any) -> dict[str, Any]:
    """All fields of a configuration as nested tables for JSON, with settings and absolute paths."""
    tables: dict[str, Any] = {}
    for field in fields(config):
        value = getattr(config, field.name)
        if field.name == "settings":
            for path, setting in value.items():
                *outer, name = path.split(".")
                table = tables
                for part in outer:
                    table = table.setdefault(part, {})
                table[name] = setting
        else:
            tables[field.name] = tables_of(value) if is_dataclass(value) else str(value.resolve()) if isinstance(value, Path) else value
    return tables


def values_of(tables: Mapping[str, Any], kind: str, prefix: str = "") -> dict[str, Any]:
    """The values in a file's tables, by path; BadInput names the place and the `kind` of file."""
    values: dict[str, Any] = {}
    for key, value in tables.items():
        path = f"{prefix}{key}"
        field = config_fields().get(path)
        if field is None and isinstance(value, dict) and any(name.startswith(f"{path}.") for name in config_fields()):
            values |= values_of(value, kind, f"{path}.")
            continue
        if field is None:
            raise BadInput(_unknown_key(path, value, kind))
        values[path] = field.parse_value(value, kind)
    return values


def with_settings(of_options: Mapping[str, Any], settings: Sequence[str], section: str = "") -> dict[str, Any]:
    """The values `of_options` with those of `--set PATH=VALUE`, by path; BadInput for a path
    that is unknown, outside of the `section` or there twice, and a value of another kind."""
    values = dict(of_options)
    for text in settings:
        path, equals, value = text.partition("=")
        path = path.strip().replace("-", "_")
        field = config_fields().get(path)
        if not equals or field is None or not path.startswith(section):
            raise BadInput(f"--set {text!r} sets nothing: {_instead(path, section)}")
        if path in values:
            by_option = f", once as {field.option_name}" if path in of_options else ""
            raise BadInput(f"--set {path} is given twice{by_option}: keep one of them.")
        values[path] = field.parse_value(value)
    return values


def _unknown_key(path: str, value: Any, kind: str) -> str:
    if path not in NEW_PATHS and any(name.startswith(f"{path}.") for name in config_fields()):
        return f"{path} is {value!r}, expected a section, [{path}]."
    sections = {name.rpartition(".")[0] for name in config_fields()} - {""}
    if isinstance(value, dict) and (near := get_close_matches(path, sections, 1)):
        return f"{path} is not a section of a {kind}: did you mean [{near[0]}]?"
    return f"{path} is not a key of a {kind}: {_instead(path, expected='expected')}"


def _instead(path: str, section: str = "", expected: str = "expected PATH=VALUE with") -> str:
    """What to write in place of an unknown path: the path of a bare or an option's name, that of
    one spelled alike, else what there is."""
    if path in NEW_PATHS:
        return f"it is {NEW_PATHS[path]} now."
    paths = [name for name in config_fields() if name.startswith(section)]
    if path in paths:
        return f"expected {path}=VALUE."
    leaf = path.rpartition(".")[2]
    meant = [name for name in paths if name.rpartition(".")[2] == leaf]
    if meant:
        return f"use {' or '.join(meant)}."
    alike = {name.rpartition(".")[2]: name for name in paths} | {config_fields()[name].typed_name: name for name in paths}
    near = get_close_matches(path, paths, 1, 0.87) or [alike[name] for name in get_close_matches(leaf, alike, 1, 0.8)]
    if near:
        return f"did you mean {near[0]}?"
    of_section = [name for name in paths if name.startswith(f"{path.partition('.')[0]}.")]
    sections = dict.fromkeys(name if "." not in name else f"{name.partition('.')[0]}.…" for name in paths)
    return f"{expected} one of {', '.join(of_section or sections)}."
