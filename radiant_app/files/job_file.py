"""TOML files that `radiant run` starts from, checked as a whole before anything starts.

A run file has the sections of `RunConfig`:

    source = "photos/harbour"
    out = "harbour_run"
    [plan]
    method = "even"
    [train]
    num_steps = 300
    sky = false                          # any field of TrainConfig

A job file lists several runs for one night:

    [defaults]                           # for every job that does not say otherwise
    train-preset = "draft"

    [[job]]
    name = "harbour"
    source = "photos/harbour"
    system = "two_edges.toml"

    [[job]]
    name = "quarry"
    source = "/data/quarry"
    out = "quarry_again"                 # left out: the job's name
    steps = 300
    set = ["train.sky=false"]

Its keys are the options of `radiant run` without the dashes before them. Paths are relative to the
file; a job's `out` is relative to the batch's folder.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, create_model

from radiant_app.config.fields import ConfigField, config_fields, config_of, values_of, with_settings
from radiant_app.config.paths import absolute_path, path_of_text
from radiant_app.config.run_config import RunConfig
from radiant_app.files.toml_file import load_toml
from radiant_app.workers.sources import detect_source
from radiant_core.errors import BadInput
from radiant_core.io.strict import Strict, problem_sentence

RECORDS = "jobs"
"""Folder of the batch that holds one folder per job: its arguments, its log, its seal."""
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
_Text = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class Job:
    """One run of a batch; all paths absolute."""

    name: str
    config: RunConfig
    input_files: tuple[Path, ...]
    """Files and folders besides the source that the run reads."""


def is_job_file(path: Path) -> bool:
    """Whether a TOML file lists jobs; else it is a run file."""
    return not {"job", "defaults"}.isdisjoint(load_toml(path, "run or job file"))


def load_run_file(path: Path) -> dict[str, Any]:
    """Path of `config_fields` → value in a run file, paths absolute; BadInput names the place."""
    try:
        return _make_absolute(values_of(load_toml(path, "run file"), "run file"), path.resolve().parent)
    except BadInput as error:
        raise BadInput(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from error


def load_jobs(path: Path, folder: Path) -> tuple[Job, ...]:
    """The jobs of a file for the batch in `folder`, in order; BadInput names file and place of an
    unknown key, a wrong value, contradicting options, a name twice, a missing source or file, and
    an `out` in or around another's or the batch's own."""
    tables = load_toml(path, "job file")
    try:
        content = _file_model().model_validate(tables)
    except ValidationError as error:
        raise BadInput(f"{path}: {problem_sentence(error, 'job file', model=_file_model())}") from error
    base, folder = path.resolve().parent, folder.resolve()
    defaults = _dump_given(content.defaults)
    try:
        jobs = tuple(_job({**defaults, **_dump_given(table)}, base, folder) for table in content.job)
        _check(jobs, folder)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return jobs


def _job(options: dict[str, Any], base: Path, folder: Path) -> Job:
    name = options.pop("name")
    fields_of_options = {**_job_options(), "source": config_fields()["source"]}
    try:
        out = absolute_path(path_of_text(options.pop("out", name), "out"), folder, "out")
        settings = options.pop("set", ())
        values = _make_absolute(
            with_settings(
                {fields_of_options[key].path: fields_of_options[key].of_option(value) for key, value in options.items()}, settings
            ),
            base,
        )
        config = config_of({**values, "out": out})
    except BadInput as error:
        raise BadInput(f"job {name!r}: {error}") from error
    files = tuple(value for path, value in values.items() if isinstance(value, Path) and path != "source")
    return Job(name=name, config=config, input_files=files)


def _check(jobs: Sequence[Job], folder: Path) -> None:
    twice = [name for name, count in Counter(job.name.lower() for job in jobs).items() if count > 1]
    if twice:
        raise BadInput(f"the name {twice[0]!r} comes twice: names name folders and must differ by more than capitals.")
    for index, job in enumerate(jobs):
        out = job.config.out
        try:
            detect_source(job.config.source, job.config.sfm.poses)
        except BadInput as error:
            raise BadInput(f"job {job.name!r}: {error}") from error
        for file in job.input_files:
            if not file.exists():
                raise BadInput(f"job {job.name!r}: {file} is no file or folder: correct the path; it is relative to the job file.")
        if folder.is_relative_to(out) or out.is_relative_to(folder / RECORDS):
            raise BadInput(f"job {job.name!r}: out is {out}, which the batch needs for itself: choose another folder.")
        for earlier in jobs[:index]:
            if out.is_relative_to(earlier.config.out) or earlier.config.out.is_relative_to(out):
                raise BadInput(f"jobs {earlier.name!r} and {job.name!r} share the out {out}: give each a folder of its own.")


def _make_absolute(values: dict[str, Any], base: Path) -> dict[str, Any]:
    return {path: absolute_path(value, base, path) if isinstance(value, Path) else value for path, value in values.items()}


def _dump_given(model: Any) -> dict[str, Any]:
    return model.model_dump(by_alias=True, exclude_unset=True)


@cache
def _job_options() -> dict[str, ConfigField]:
    """Key of a job → its field."""
    fields = [field for field in config_fields().values() if field.option is not None and field.path not in ("source", "out")]
    return {field.option_name.removeprefix("--"): field for field in fields}


@cache
def _file_model() -> Any:
    fields: dict[str, Any] = {
        f"option_{index}": (field.typed_kind, Field(default=None, alias=key)) for index, (key, field) in enumerate(_job_options().items())
    }
    settings: Any = (list[str], Field(default=[], alias="set"))
    options = create_model("Defaults", __base__=Strict, **fields, settings=settings)
    job: Any = create_model("Job", __base__=options, name=(_Name, ...), source=(_Text, ...), out=(_Text, None))
    jobs: Any = Annotated[list[job], Field(min_length=1)]
    return create_model("JobFile", __base__=Strict, defaults=(options, options()), job=(jobs, ...))
