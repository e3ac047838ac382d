"""The keyframes of a flight, kept in flight.json beside the run. Once per keyframe; some ms.

{"schema": "radiant.flight", "version": 1,
 "keyframes": [{"position": [x, y, z], "focal_point": …, "up": …, "angle_deg": 30}, …]}
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.run_store import read_bounded, write_json
from radiant_core.io.strict import Strict, problem_sentence
from radiant_viewer.pictures.view_pose import ViewPose

SCHEMA, VERSION = "radiant.flight", 1
MAX_FILE_BYTES, MAX_KEYFRAMES = 1 << 20, 1000
Triple = tuple[float, float, float]


class PoseRecord(Strict):
    """A view in a file."""

    position: Triple
    focal_point: Triple
    up: Triple
    angle_deg: float

    def pose(self) -> ViewPose:
        """The view."""
        return ViewPose(**self.model_dump())


def pose_record(pose: ViewPose) -> dict[str, Any]:
    """A view as JSON has it."""
    return {name: getattr(pose, name).tolist() for name in ("position", "focal_point", "up")} | {"angle_deg": pose.angle_deg}


class _File(Strict):
    schema_: Literal["radiant.flight"] = Field(alias="schema")
    version: Literal[1]
    keyframes: list[PoseRecord] = Field(max_length=MAX_KEYFRAMES)


class FlightFile:
    """The flight of a run's folder, or of a model's file."""

    def __init__(self, subject: Path) -> None:
        self.path = subject / "flight.json" if subject.is_dir() else subject.with_name(f"{subject.stem}.flight.json")

    def load(self) -> list[ViewPose]:
        """The keyframes, none without a file; StoreDamaged where it is broken."""
        if not self.path.exists():
            return []
        try:
            return [record.pose() for record in _File.model_validate_json(read_bounded(self.path, MAX_FILE_BYTES)).keyframes]
        except ValidationError as error:
            problem = problem_sentence(error, "file of keyframes")
        except BadInput as error:
            problem = str(error)
        raise StoreDamaged(f"{self.path} holds no keyframes ({problem}): move it away, and begin anew.")

    def keep(self, keyframes: Sequence[ViewPose]) -> None:
        """Write them; raises as `load`, whose broken file is not replaced, as `write_json`, and
        BadInput for too many."""
        self.load()
        if len(keyframes) > MAX_KEYFRAMES:
            raise BadInput(f"a flight has {len(keyframes)} keyframes, expected at most {MAX_KEYFRAMES:,}: remove some.")
        write_json(self.path, {"schema": SCHEMA, "version": VERSION, "keyframes": [pose_record(pose) for pose in keyframes]})
