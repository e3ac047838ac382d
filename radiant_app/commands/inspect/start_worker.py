"""A process that answers the start window: `python -m radiant_app.commands.inspect.start_worker`.

One JSON line per request on standard input, one per answer on standard output, in order:

    {"look": path}                              →  its `start_look.SourceSummary`, "out" for a run
    {"forecast": {"path", "out", "system", "system_as", "quality"}}
                                                →  its lines and "command", arguments of `radiant`
                                                   that name the system file as `system_as`
    {"machines": [row, …], "path": file}        →  {"written": file}
    {"profiles": true}                          →  {"profiles": {name: machine}}

or {"error": one sentence}; each with "asked", the request's number. The window waits neither for
torch nor for a thousand photographs. Ends with its standard input.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, get_args

from pydantic import TypeAdapter, ValidationError

from radiant_app.answering import answering
from radiant_app.commands.inspect.start_forecast import (
    MachineRow,
    QualityName,
    command_of,
    forecast_start,
    free_folder,
    quality_of,
    save_system,
)
from radiant_app.commands.inspect.start_look import SourceSummary, look_at
from radiant_app.files.profile_file import library_profiles, load_profile
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.strict import problem_sentence

MAX_PLACES = 20_000
"""A map shows no more of them."""


class Starting:
    """Answers requests; what was looked at last is kept for its forecasts."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._source: SourceSummary | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do what is asked; a RadiantError becomes its sentence."""
        reply = {"asked": request.get("asked", 0)}
        try:
            if "look" in request:
                return reply | self._look(Path(request["look"]))
            if "forecast" in request:
                return reply | self._forecast(request["forecast"])
            if "machines" in request:
                return reply | _write_machines(request["machines"], Path(request["path"]))
            return reply | {"profiles": {name: load_profile(path).machine for name, path in library_profiles().items()}}
        except RadiantError as error:
            return reply | {"error": str(error)}

    def _look(self, path: Path) -> dict[str, Any]:
        source = self._source = look_at(path, lambda num_done, total: self._say(f"reading {num_done:,} of {total:,} photographs"))
        step = 1 + len(source.places) // MAX_PLACES
        fields = ("title", "next", "num_photographs", "places_are", "unit", "notes")
        out = "" if source.next == "open" else str(free_folder(path, "_plan" if source.next == "plan" else "_run"))
        return {
            **{name: getattr(source, name) for name in fields},
            "path": str(path),
            "places": source.places[::step].round(3).tolist(),
            "out": out,
        }

    def _forecast(self, choice: dict[str, Any]) -> dict[str, Any]:
        path, name = Path(choice["path"]), choice["quality"]
        if name not in get_args(QualityName):
            raise BadInput(f"{name!r} is no quality: choose one of {', '.join(get_args(QualityName))}.")
        source = self._source if self._source is not None and self._source.path == path else look_at(path)
        system, system_as = (Path(choice[key]) if choice.get(key) else None for key in ("system", "system_as"))
        quality = quality_of(name)
        command = command_of(source, Path(choice["out"]), system_as or system, quality)
        return {**asdict(forecast_start(source, system, quality)), "command": command}


def _write_machines(rows: Any, path: Path) -> dict[str, Any]:
    try:
        machines = TypeAdapter(list[MachineRow]).validate_python(rows)
    except ValidationError as error:
        raise BadInput(f"the machines cannot be used ({problem_sentence(error, 'form')}): correct their line.") from error
    save_system(machines, path)
    return {"written": str(path)}


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer requests until the stream ends."""
    starting = Starting(lambda words: print(words, file=sys.stderr, flush=True))
    for line in requests:
        answers.write(json.dumps(starting.answer(json.loads(line))).encode() + b"\n")
        answers.flush()


def main() -> int:
    """Run the process and return its exit code."""
    with answering() as pipe:
        serve(sys.stdin.buffer, pipe)
    return 0


if __name__ == "__main__":
    sys.exit(main())
