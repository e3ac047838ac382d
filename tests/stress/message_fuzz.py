"""Mutated messages of the network: seeded, so that a finding can be found again by its kind and number.

    report = fuzz_kind(KINDS["poll"], count, seed)     every mutated message is parsed, and used where it passes
    report.surprises                                   [] where each was refused with an error of ours, or used by all that use it

What is mutated is in `message_kinds.py`. By hand: `python -m tests.stress.message_fuzz 20000 [KIND …]`; with `+NUMBER` after a kind
that one message alone, with its traceback.
"""

from __future__ import annotations

import json
import random
import sys
import time
import traceback
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

from radiant_app.files import run_folder
from tests.memory_folder import memory_folder
from tests.stress.message_kinds import KINDS, REFUSALS, Kind
from tests.stress.reader_fuzz import mutated

SEED = 58
SHOWN = 8
"""Surprises kept, one of each cause; the rest are counted."""
RAW = {"@deep": "[" * 3000 + "]" * 3000, "@deeper": '{"a":' * 3000 + "0" + "}" * 3000, "@open": "[" * 3900, "@digits": "1" * 5000,
       "@beyond": "1e999", "@tiny": "1e-320", "@nan": "NaN", "@inf": "-Infinity"}  # fmt: skip
"""What no writer of JSON writes, put in by its text."""
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 5, 7, 2**31, 2**63, 10**8, 10**18, 10**400, 0.5, -0.0, 1e300, -1e300, 1.7e308, 5e-324, "", "1", "nan"),
    *(
        [],
        {},
        [1],
        [[]],
        [[], {}],
        {"a": 1},
        "a" * 5000,
        "é" * 300,
        "\x1b]0;owned\x07",
        "a\nb\r\x9b2J",
        "\u202egnp",
        "\x00",
        "\ud800",
        "\udc80",
    ),
    *("../../etc/hostname", "/etc/hostname", "devices/c", "edges/north", "devices/d", "cloud", "task.json", "a" * 64, "0" * 32, *RAW),
)
Path_ = tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Report:
    """What came of so many mutated messages of one kind."""

    kind: str
    count: int
    num_refused: int
    num_surprises: int
    surprises: list[str]
    """Number and error, one of each cause."""
    longest_s: float
    longest_number: int
    seconds: float


def mutated_message(data: bytes, rng: random.Random) -> bytes:
    """A message with some bytes, or some values of its JSON, changed."""
    if rng.random() < 0.3 or not data.startswith((b"{", b"[")):
        return mutated(data, rng)
    record = {"": json.loads(data)}
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        _edit(record, rng)
    text = json.dumps(record[""])
    for name, raw in RAW.items():
        text = text.replace(f'"{name}"', raw)
    if rng.random() < 0.05 and '{"' in text:
        # A key that stands there twice.
        text = text.replace('{"', '{"' + text.split('{"', 1)[1].split('"', 1)[0] + '": 0, "', 1)
    return mutated(text.encode(), rng) if rng.random() < 0.05 else text.encode()


def _edit(record: dict[str, Any], rng: random.Random) -> None:
    """Change one value, wherever it stands."""
    places = [*_places(record)]
    holder, key = rng.choice(places)
    kind = rng.randrange(8)
    if kind <= 3:
        holder[key] = deepcopy(rng.choice(VALUES))
    elif kind == 4 and isinstance(holder[key], int | float):
        value = holder[key]
        holder[key] = rng.choice(
            (-value, value * 1000 + 1, value + 0.5 if abs(value) < 1e300 else 1e300, str(value), [value], bool(value), value + 1)
        )
    elif kind == 4:
        holder[key] = [deepcopy(holder[key])]
    elif kind == 5 and key != "":
        del holder[key]
    elif kind == 6:
        other, name = rng.choice(places)
        holder[key] = deepcopy(other[name])
    elif isinstance(holder[key], dict):
        holder[key][rng.choice(("extra", "", "__class__", "event", "\ud800", "a" * 300, "../x"))] = deepcopy(rng.choice(VALUES))
    elif isinstance(holder[key], list):
        holder[key] = [deepcopy(each) for each in holder[key] * rng.choice((0, 2, 300))]


def _places(record: Any) -> Iterator[tuple[Any, Any]]:
    """Every holder of a value with its key or index."""
    for key, value in [*record.items()] if isinstance(record, dict) else [*enumerate(record)]:
        yield record, key
        if isinstance(value, dict | list):
            yield from _places(value)


def fuzz_kind(kind: Kind, count: int, seed: int, first: int = 0) -> Report:
    """Parse, and where they pass use, `count` mutated messages of a kind; `first` skips to a number that was reported."""
    causes: dict[str, str] = {}
    num_refused = num_surprises = longest_number = 0
    longest_s, begun_s = 0.0, time.monotonic()
    # The same in every manifest of a process, and dear to find out.
    versions = patch.object(run_folder, "software_versions", return_value=run_folder.software_versions())
    with versions, memory_folder() as folder, kind.open(folder) as message:
        message.use(message.parse(message.specimen))
        for number in range(first, first + count):
            rng = random.Random(f"{seed} {kind.name} {number}")
            data = mutated_message(message.specimen, rng)
            begun = time.process_time()
            try:
                value = message.parse(data)
            except REFUSALS as error:
                num_refused += 1
                if not str(error):
                    num_surprises += 1
                    causes.setdefault("wordless", f"{kind.name} {number}: refused without a word")
            except Exception as error:  # noqa: BLE001 whatever else comes is what is looked for
                num_surprises += 1
                causes.setdefault(_cause(error), f"{kind.name} {number}: parse: {_said(error)}")
            else:
                try:
                    message.use(value)
                except Exception as error:  # noqa: BLE001 what passed has to be usable
                    num_surprises += 1
                    causes.setdefault(_cause(error), f"{kind.name} {number}: use: {_said(error)}")
            if (seconds := time.process_time() - begun) > longest_s:
                longest_s, longest_number = seconds, number
    return Report(
        kind=kind.name,
        count=count,
        num_refused=num_refused,
        num_surprises=num_surprises,
        surprises=[*causes.values()][:SHOWN],
        longest_s=longest_s,
        longest_number=longest_number,
        seconds=time.monotonic() - begun_s,
    )


def _cause(error: Exception) -> str:
    """The same for the same line of code."""
    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if "radiant" in frame.filename or "message_kinds" in frame.filename
    ]
    return f"{type(error).__name__} {frames[-1].filename if frames else ''}:{frames[-1].lineno if frames else 0}"


def _said(error: Exception) -> str:
    where = _cause(error).rsplit("/", 1)[-1]
    return f"{type(error).__name__} at {where}: {ascii(str(error))[:160]}"


def main(arguments: list[str]) -> None:
    """Print a row per kind."""
    count, names = int(arguments[0]), arguments[1:] or [*KINDS]
    for name, _, number in (each.partition("+") for each in names):
        report = fuzz_kind(KINDS[name], 1 if number else count, SEED, int(number or 0))
        tail = f", longest {1e3 * report.longest_s:.0f} ms (number {report.longest_number}), {report.seconds:.0f} s"
        print(f"{name}: {report.count} mutated, {report.num_refused} refused, {report.num_surprises} surprises{tail}", flush=True)
        for surprise in report.surprises:
            print(f"    {surprise}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
