"""A process that measures for the inspector: `python -m radiant_app.commands.survey.worker RUN`.

One JSON line per request on standard input, one per answer on standard output:

    {"measure": kind, "points": [[x, y, z or null], …] of the world, "eyes": [[x, y, z], …] from
     where they were clicked, "name": …, "base": …}
    {"remove": name}    {"export": path}    →    {"name": …} or {"error": one sentence}
    {"prepare": true}   →    {"prepared": true}: the surface is made or read, for the next measure

What is kept is what `radiant measure` keeps, by the same functions; progress goes to standard
error. The run and its surface are read for the first measure, and anew once its files changed. Ends
with its standard input or by SIGTERM, and then leaves no half-written file behind.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import IO, Any, get_args

import numpy as np

from radiant_app.answering import answering
from radiant_app.commands.survey import measure as measures
from radiant_app.commands.survey.parts import Survey, load_survey
from radiant_app.report.progress import ProgressDisplay, terminal_display
from radiant_core.choices import MeasureKind
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.measures_file import load_measures
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import HeightMap
from radiant_core.survey.measures import measure, require_measure
from radiant_viewer.runs.run_view import FileStamps, file_stamps


class Measuring:
    """Answers requests about one run."""

    def __init__(self, run: Path, display: ProgressDisplay) -> None:
        self._run, self._display = run, display
        self._cached: tuple[FileStamps, Survey, HeightMap] | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do what is asked; a RadiantError becomes its sentence."""
        try:
            if "prepare" in request:
                self._surface()
                return {"prepared": True}
            if "measure" in request:
                return {"name": self._measure(request)}
            if "remove" in request:
                measures.take_out(self._run, load_measures(self._run), str(request["remove"]))
                return {"name": str(request["remove"])}
            path = Path(str(request["export"]))
            measures.require_export_name(path)
            measures.export_measures(path, load_measures(self._run), load_survey(self._run).map_frame)
            return {"name": path.name}
        except RadiantError as error:
            return {"error": str(error)}

    def _measure(self, request: dict[str, Any]) -> str:
        kind, wanted = request["measure"], request.get("name")
        if kind not in get_args(MeasureKind):
            raise BadInput(f"{kind!r} is no kind of measure: choose one of {', '.join(get_args(MeasureKind))}.")
        measures.name_for(kind, wanted, load_measures(self._run))
        points, eyes = (_rows(request[name]) for name in ("points", "eyes"))
        require_measure(kind, points, request.get("base"))
        survey, surface = self._surface()
        places, sigmas = measures.clicked_places(survey, surface, points, eyes)
        measured = measure(kind, places, surface, measures.accuracy_of(survey), request.get("base"), sigmas)
        return measures.keep(survey, wanted, measured)[0]

    def _surface(self) -> tuple[Survey, HeightMap]:
        stamps = file_stamps(self._run)
        if self._cached is None or self._cached[0] != stamps:
            survey = load_survey(self._run)
            self._cached = stamps, survey, measures.surface_for_measures(survey, None, self._display)
        return self._cached[1:]


def _rows(points: list[list[float | None]]) -> FloatArray:
    """Places (P,3), NaN for null."""
    return np.array([[np.nan if value is None else value for value in point] for point in points], np.float64).reshape(-1, 3)


def serve(run: Path, requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer requests until the stream ends."""
    measuring = Measuring(run, terminal_display())
    for line in requests:
        answers.write(json.dumps(measuring.answer(json.loads(line))).encode() + b"\n")
        answers.flush()


def main() -> int:
    """Run the process and return its exit code."""
    with answering() as pipe:
        serve(Path(sys.argv[1]), sys.stdin.buffer, pipe)
    return 0


if __name__ == "__main__":
    sys.exit(main())
