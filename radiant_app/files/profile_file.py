"""Curve files: the profile of a machine, written by `radiant machine profile`, named by system
files.

    kind = "measured"                    # or "estimate", which every plan says
    machine = "workstation, 8 threads"
    source = "radiant machine profile on 53 photographs"
    memory_gb = 12.0                     # what training may hold; left out: unknown
    frames_s = 8.0                       # two models into one frame, of which GPS is unsure
    frames_alone_s = 6.0                 # the same with no process beside it, as at the cloud
    launch_s = 0.004                     # of a step, whatever its pixels and Gaussians
    latency_s = 0.0001                   # of a message between two processes, one way
    add_s_per_byte = 2e-9                # of adding up what machines send that train together

    [key]                                # the training that the curves hold for
    preset = "default"
    num_steps = 1500
    long_side_px = 576
    max_num_splats = 200000              # left out: not known

    [init_s]                             # G; also [train_s], [model_bytes]; of edges [aggregate_s],
                                         # [aggregate_alone_s]; of the cloud [merge_s]; [sfm_s], of
                                         # devices that place their own photographs
    constant = 4.0
    linear = 0.1
    range = [7, 53]                      # counts it was fitted on: extrapolated beyond twice 53
    rmse = 0.0                           # root mean square and largest relative error
    worst_error = 0.0
    samples = [[7, 4.7], [53, 9.3]]      # camera count, measured value

A curve is constant + linear · c + power_coefficient · c ** exponent. What is read is checked:
samples that rise, and errors that are those of the samples. The library lies in `profiles/`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from radiant_app.files.toml_file import MAX_FILE_BYTES, load_toml
from radiant_core.errors import BadInput
from radiant_core.io.run_store import parse_json, write_atomic
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import FittedCurve
from radiant_core.plan.profiles.profile import Profile, ProfileKey

KIND = "curve file"
SUFFIXES = (".toml", ".json")
LIBRARY = Path(__file__).parents[1] / "profiles"
_BYTES_PER_GB = 1e9
_CURVES = ("init_s", "train_s", "model_bytes", "aggregate_s", "aggregate_alone_s", "merge_s", "sfm_s")

_NonNegative = Annotated[float, Field(ge=0, le=1e15)]
_Count = Annotated[int, Field(ge=1, le=10**9)]
_Name = Annotated[str, Field(min_length=1, max_length=500)]


class _Fitted(Strict):
    constant: _NonNegative = 0.0
    linear: _NonNegative = 0.0
    power_coefficient: _NonNegative = 0.0
    exponent: Annotated[float, Field(ge=0, le=4)] = 1.0
    range: Annotated[list[_Count], Field(min_length=2, max_length=2)]
    rmse: _NonNegative | None = None
    worst_error: _NonNegative | None = None
    samples: list[Annotated[list[_NonNegative], Field(min_length=2, max_length=2)]] = Field(default=[])

    def build(self) -> FittedCurve:
        if any(count != int(count) for count, _ in self.samples):
            raise BadInput("a sample's camera count is no whole number: the first of each pair is a count.")
        return FittedCurve(
            curve=CostCurve(constant=self.constant, linear=self.linear, power_coefficient=self.power_coefficient, exponent=self.exponent),
            smallest_count=self.range[0],
            largest_count=self.range[1],
            samples=tuple((int(count), value) for count, value in self.samples),
            rmse=self.rmse,
            worst_error=self.worst_error,
        )


class _Key(Strict):
    preset: _Name
    num_steps: _Count
    long_side_px: _Count
    max_num_splats: _Count | None = None
    aggregate_preset: _Name = "default"


class _File(Strict):
    kind: Literal["measured", "estimate"]
    machine: _Name
    source: Annotated[str, Field(min_length=1, max_length=2000)]
    memory_gb: Annotated[float, Field(gt=0, le=1e6)] | None = None
    measured_steps: _Count | None = None
    frames_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    frames_alone_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    launch_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    latency_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    add_s_per_byte: Annotated[float, Field(gt=0, le=1e9)] | None = None
    key: _Key
    init_s: _Fitted
    train_s: _Fitted
    model_bytes: _Fitted
    aggregate_s: _Fitted | None = None
    aggregate_alone_s: _Fitted | None = None
    merge_s: _Fitted | None = None
    sfm_s: _Fitted | None = None

    def build(self, name: str) -> Profile:
        fits: dict[str, _Fitted | None] = {curve: getattr(self, curve) for curve in _CURVES}
        curves: dict[str, Any] = {}
        for curve, fitted in fits.items():
            try:
                curves[curve] = None if fitted is None else fitted.build()
            except BadInput as error:
                raise BadInput(f"{curve}: {error}") from error
        return Profile(
            name=name,
            kind=self.kind,
            machine=self.machine,
            source=self.source,
            key=ProfileKey(**self.key.model_dump()),
            memory_bytes=None if self.memory_gb is None else self.memory_gb * _BYTES_PER_GB,
            measured_steps=self.measured_steps,
            frames_s=self.frames_s,
            frames_alone_s=self.frames_alone_s,
            launch_s=self.launch_s,
            latency_s=self.latency_s,
            add_s_per_byte=self.add_s_per_byte,
            **curves,
        )


def load_profile(path: Path, name: str | None = None) -> Profile:
    """The profile in a TOML or JSON file; BadInput names the file, the key and what is expected."""
    tables = _load_json(path) if path.suffix == ".json" else load_toml(path, KIND)
    try:
        return _File.model_validate(tables).build(name or path.name)
    except ValidationError as error:
        raise BadInput(f"{path}: {problem_sentence(error, KIND, model=_File)}") from error
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


def save_profile(path: Path, profile: Profile) -> None:
    """Write the profile as TOML or JSON by its ending, atomically; BadInput for another ending."""
    if path.suffix not in SUFFIXES:
        raise BadInput(f"{path} is no name for a {KIND}: choose one that ends in {' or '.join(SUFFIXES)}.")
    record = _record(profile)
    text = json.dumps(record, indent=1, ensure_ascii=False) + "\n" if path.suffix == ".json" else _toml(record)
    write_atomic(path, text.encode())


def library_profiles() -> dict[str, Path]:
    """Name → curve file of every machine in the library."""
    return {path.stem: path for path in sorted(LIBRARY.glob("*.toml"))}


def find_profile(name: str, folder: Path) -> Profile:
    """The profile that a system file in `folder` names: one of the library, or a curve
    file relative to it."""
    if name.endswith(SUFFIXES):
        return load_profile(folder / name, name)
    profiles = library_profiles()
    if name not in profiles:
        raise BadInput(
            f"profile {name!r} is not in the library: use one of {', '.join(profiles)}, or a curve file ending in .toml or .json."
        )
    return load_profile(profiles[name], name)


def _load_json(path: Path) -> Any:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}): give a {KIND} in TOML or JSON.") from error
    if len(data) > MAX_FILE_BYTES:
        raise BadInput(f"{path}: larger than {MAX_FILE_BYTES} bytes, which no {KIND} is: check the path.")
    try:
        return parse_json(data)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not a JSON file ({error}): correct it there.") from error


def _record(profile: Profile) -> dict[str, Any]:
    key = profile.key
    tables = {name: _fitted_record(getattr(profile, name)) for name in _CURVES if getattr(profile, name) is not None}
    record = {
        "kind": profile.kind,
        "machine": profile.machine,
        "source": profile.source,
        "memory_gb": None if profile.memory_bytes is None else profile.memory_bytes / _BYTES_PER_GB,
        "measured_steps": profile.measured_steps,
        "frames_s": profile.frames_s,
        "frames_alone_s": profile.frames_alone_s,
        "launch_s": profile.launch_s,
        "latency_s": profile.latency_s,
        "add_s_per_byte": profile.add_s_per_byte,
        "key": _drop_none(vars(key)),
        **tables,
    }
    return _drop_none(record)


def _fitted_record(fitted: FittedCurve) -> dict[str, Any]:
    record = {
        **{name: float(value) for name, value in vars(fitted.curve).items()},
        "range": [fitted.smallest_count, fitted.largest_count],
        "rmse": fitted.rmse,
        "worst_error": fitted.worst_error,
        "samples": [[count, value] for count, value in fitted.samples] or None,
    }
    return _drop_none(record)


def _drop_none(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in record.items() if value is not None}


def _toml(record: dict[str, Any]) -> str:
    """Tables of text, numbers and lists, which JSON writes as TOML does: 1e-05 is valid in both."""
    lines = ["# Cost curves of one machine, for `profile` in a system file; written by `radiant machine profile`."]
    lines += [f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in record.items() if not isinstance(value, dict)]
    for name, table in record.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"
