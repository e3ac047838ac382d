"""The job file: several runs for one night, written by a user in TOML and checked as a whole before anything starts.

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

Keys are the options of `radiant run` without the dashes before them, read from the command itself, so that the two cannot differ.
Paths are relative to the file; `out` is relative to the batch's folder.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import Field, ValidationError, create_model

from radiant_app.files.toml_file import Strict, load_toml, sentence
from radiant_app.workers.sources import detect_source
from radiant_core.errors import BadInput

RECORDS = "jobs"
"""Folder of the batch that holds one folder per job: its arguments, its log, its seal."""
_OWN = ("context", "source", "out", "resume", "as_json")
"""Parameters of `radiant run` that are not options of a job: the batch sets them."""
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
_Text = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class Job:
    """One run of a batch; all paths absolute."""

    name: str
    source: Path
    out: Path
    options: dict[str, Any]
    """Option of `radiant run` without its dashes → value."""

    @property
    def arguments(self) -> tuple[str, ...]:
        """What a user would type after `radiant run` for this job alone."""
        typed = [str(self.source), f"--out={self.out}"]
        for key, value in self.options.items():
            if isinstance(value, bool):
                typed += [f"--{key}"] * value
            else:
                typed += [f"--{key}={each}" for each in (value if isinstance(value, list) else [value])]
        return tuple(typed)

    @property
    def input_files(self) -> tuple[Path, ...]:
        """Files and folders besides the source that the run reads."""
        return tuple(value for value in self.options.values() if isinstance(value, Path))


def is_job_file(source: Path) -> bool:
    """Whether the argument of `radiant run` names a job file: photographs lie in folders."""
    return source.suffix == ".toml" and not source.is_dir()


def load_jobs(path: Path, folder: Path) -> tuple[Job, ...]:
    """The jobs of a file for the batch in `folder`, in order.

    Raises BadInput naming file and place for an unknown key, a value of the wrong kind, a name twice, a source or file that is not
    there, or an `out` that is another's, lies in or around it, or is the batch's own.
    """
    tables = load_toml(path, "job file")
    try:
        content = _file_model().model_validate(tables)
    except ValidationError as error:
        raise BadInput(f"{path}: {sentence(error, 'job file')}") from error
    base, folder = path.resolve().parent, folder.resolve()
    defaults = _given(content.defaults)
    jobs = tuple(_job(_given(each), defaults, base, folder) for each in content.job)
    try:
        _check(jobs, folder)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return jobs


def _job(own: dict[str, Any], defaults: dict[str, Any], base: Path, folder: Path) -> Job:
    name, source, out = own.pop("name"), own.pop("source"), own.pop("out", None)
    paths = _path_options()
    options = {key: _absolute(base, value) if key in paths else value for key, value in {**defaults, **own}.items()}
    return Job(name=name, source=_absolute(base, source), out=_absolute(folder, out or name), options=options)


def _check(jobs: Sequence[Job], folder: Path) -> None:
    twice = [name for name, count in Counter(job.name.lower() for job in jobs).items() if count > 1]
    if twice:
        raise BadInput(f"the name {twice[0]!r} comes twice: names name folders and must differ by more than capitals.")
    for index, job in enumerate(jobs):
        try:
            detect_source(job.source)
        except BadInput as error:
            raise BadInput(f"job {job.name!r}: {error}") from error
        for file in job.input_files:
            if not file.exists():
                raise BadInput(f"job {job.name!r}: {file} is no file or folder: correct the path; it is relative to the job file.")
        if folder.is_relative_to(job.out) or job.out.is_relative_to(folder / RECORDS):
            raise BadInput(f"job {job.name!r}: out is {job.out}, which the batch needs for itself: choose another folder.")
        for other in jobs[:index]:
            if job.out.is_relative_to(other.out) or other.out.is_relative_to(job.out):
                raise BadInput(f"jobs {other.name!r} and {job.name!r} share the out {job.out}: give each a folder of its own.")


def _absolute(base: Path, text: str) -> Path:
    return (base / Path(text).expanduser()).resolve()


def _given(model: Any) -> dict[str, Any]:
    return model.model_dump(by_alias=True, exclude_unset=True)


@cache
def _options() -> dict[str, tuple[Any, Any]]:
    """Parameter of `radiant run` → its type and typer's description."""
    from radiant_app.cli.app import run

    hints = get_type_hints(run, include_extras=True)
    described = {name: get_args(hints[name]) for name in inspect.signature(run).parameters if name not in _OWN}
    return {name: (kind, info) for name, (kind, info) in described.items()}


def _typed_name(parameter: str) -> str:
    _, info = _options()[parameter]
    # Inside of Annotated, typer keeps the first name that is given where the default value would stand.
    given = (info.default, *(info.param_decls or ()))
    long = [declared for declared in given if isinstance(declared, str) and declared.startswith("--")]
    return long[0].split("/")[0].removeprefix("--") if long else parameter.replace("_", "-")


def _is_path(parameter: str) -> bool:
    kind, _ = _options()[parameter]
    return Path in (kind, *get_args(kind))


def _path_options() -> frozenset[str]:
    return frozenset(_typed_name(parameter) for parameter in _options() if _is_path(parameter))


@cache
def _file_model() -> Any:
    """The pydantic model of a job file, its options made from the signature of `radiant run`."""
    fields: dict[str, Any] = {}
    for parameter, (kind, info) in _options().items():
        limited = Annotated[_Text if _is_path(parameter) else kind, Field(ge=info.min, le=info.max)]
        fields[parameter] = (limited, Field(default=None, alias=_typed_name(parameter)))
    options = create_model("Defaults", __base__=Strict, **fields)
    job: Any = create_model("Job", __base__=options, name=(_Name, ...), source=(_Text, ...), out=(_Text, None))
    jobs: Any = Annotated[list[job], Field(min_length=1)]
    return create_model("JobFile", __base__=Strict, defaults=(options, options()), job=(jobs, ...))
