"""Frames of films as photographs in a folder. Once per source.

    FOLDER/frames.json                       what they were made from, which are taken, and why
    FOLDER/film_NAME/NAME_000123.jpg         frame 123, with its position

Positions are those of an SRT beside the film, else those in its own file. What is there of the same
films is not made again: a job that was interrupted goes on.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.film.choosing import ChosenFrames, choose_frames
from radiant_core.io.film.container import read_container
from radiant_core.io.film.exif import with_position
from radiant_core.io.film.formats import srt_beside
from radiant_core.io.film.srt import FilmTrack, read_track
from radiant_core.io.film.watching import opened_film, watch_film
from radiant_core.io.photos.folders import in_short
from radiant_core.io.run_store import content_key, read_json, write_atomic, write_json

RECORD = "frames.json"
JPEG_QUALITY = 95
LEAST_FRAMES = 3
FORM = 1
"""Of the record and of what it says to choose; another one makes all anew."""
FilmPhase = Literal["watching films", "taking frames"]
Report = Callable[[FilmPhase, int, int], None]
"""What is done (watching films, taking frames), how much, of how much."""


@dataclass(frozen=True, kw_only=True)
class FilmFrames:
    """The folder of the frames, and what is said of them."""

    folder: Path
    decision: Decision
    warnings: tuple[str, ...]


def take_frames(films: Sequence[Path], folder: Path, num_frames: int | None, report: Report) -> FilmFrames:
    """Write the sharp frames of films into `folder`, about `num_frames` of them if given.

    Raises BadInput for a film that cannot be decoded, two of one name, or films that hardly move.
    """
    names = {film: film.stem for film in films}
    if len({name.casefold() for name in names.values()}) < len(films):
        raise BadInput(f"two films in {films[0].parent} have one name ({in_short(sorted(names.values()))}): rename one.")
    key = content_key(FORM, num_frames, [[film.name, film.stat().st_size, film.stat().st_mtime_ns] for film in films])
    record = _record(folder, key)
    if record is None:
        shutil.rmtree(folder, ignore_errors=True)
        watched = {
            names[film]: watch_film(film, _of_film(report, "watching films", number, len(films))) for number, film in enumerate(films)
        }
        chosen = choose_frames(watched, num_frames)
        if chosen.num_taken < LEAST_FRAMES:
            raise BadInput(
                f"{films[0].name} moves by {100 * chosen.step * chosen.num_taken:.0f} % of its picture in all, which makes "
                f"{chosen.num_taken} photographs: film while you walk or fly around, or name more frames by --film-frames."
            )
        record = _described(chosen, key)
        folder.mkdir(parents=True)
        write_json(folder / RECORD, record)
    tracks = {film: _track_of(film) for film in films}
    for number, film in enumerate(films):
        _write_frames(film, folder, record["frames"][names[film]], tracks[film], _of_film(report, "taking frames", number, len(films)))
    decision = Decision(stage="sfm", topic="frames of films", **record["decision"], forced=num_frames is not None)
    placed = sum(track is not None and len(track.times_s) > 0 for track in tracks.values())
    summary = f"{in_short([film.name for film in films])}: {decision.choice}; {placed} of {len(films)} films have positions."
    return FilmFrames(folder=folder, decision=decision, warnings=(summary, *_warnings(films, tracks)))


def _track_of(film: Path) -> FilmTrack | None:
    """The positions of a film; None where nothing beside it or in it has any. Of a place where it
    began that place, for its first second."""
    subtitles = srt_beside(film)
    if subtitles is not None:
        return read_track(subtitles)
    track, begun = read_container(film)
    if len(track.times_s) or begun is None:
        return track if len(track.times_s) else None
    return FilmTrack(times_s=np.zeros(1), lat_lon_alt=np.array([begun]))


def frame_name(film: str, index: int) -> str:
    """Where the frame of a film lies in the folder of frames."""
    return f"film_{film}/{film}_{index:06d}.jpg"


def _described(chosen: ChosenFrames, key: str) -> dict[str, Any]:
    blurred = f"{chosen.num_blurred:,} of them blurred, of which {chosen.num_blurred_taken} are taken for want of sharp ones"
    return {
        "key": key,
        "frames": {name: [[frame.index, frame.time_s] for frame in frames] for name, frames in chosen.frames.items()},
        "decision": {
            "choice": f"{chosen.num_taken:,} of {chosen.num_watched:,} frames that were looked at, the sharpest of each stretch",
            "figure": round(100 * chosen.step, 2),
            "unit": "% of the picture between two",
            "reason": f"{chosen.reason}; {blurred}",
        },
    }


def _record(folder: Path, key: str) -> dict[str, Any] | None:
    try:
        record = read_json(folder / RECORD, ("key", "frames", "decision"))
    except RadiantError:
        return None
    return record if record["key"] == key else None


def _write_frames(
    film: Path, folder: Path, frames: Sequence[Sequence[float]], track: FilmTrack | None, report: Callable[..., None]
) -> None:
    """Write the frames (number and time of each) that are not there yet."""
    missing: Mapping[int, float] = {
        int(index): time_s for index, time_s in frames if not (folder / frame_name(film.stem, int(index))).is_file()
    }
    if not missing:
        return
    (folder / f"film_{film.stem}").mkdir(parents=True, exist_ok=True)
    with opened_film(film) as opened:
        for index in range(max(missing) + 1):
            if not opened.grab():
                raise BadInput(f"the film {film} ends before frame {index}, which was there before: run again.")
            if index in missing:
                whole, picture = opened.retrieve()
                if not whole:
                    raise BadInput(f"frame {index} of the film {film} cannot be decoded, and could before: run again.")
                _, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
                position = None if track is None else track.at(missing[index])
                jpeg = encoded.tobytes() if position is None else with_position(encoded.tobytes(), position)
                write_atomic(folder / frame_name(film.stem, index), jpeg)
            report(index + 1, max(missing) + 1)


def _of_film(report: Report, phase: FilmPhase, number: int, count: int) -> Callable[[int, int], None]:
    """Progress within one of several films, in hundredths of a film."""
    return lambda num_done, total: report(phase, 100 * number + 100 * num_done // max(1, total), 100 * count)


def _warnings(films: Sequence[Path], tracks: Mapping[Path, FilmTrack | None]) -> tuple[str, ...]:
    empty = [film.name for film in films if (track := tracks[film]) is not None and not len(track.times_s)]
    placed = [track for film in films if (track := tracks[film]) is not None and len(track.times_s)]
    notes = [f"the subtitles of {in_short(empty)} hold no position that is understood: the film has no GPS."] if empty else []
    if any(np.isfinite(track.lat_lon_alt[:, 2]).any() for track in placed):
        notes.append("heights that are written for a film may be off by tens of metres: name no vertical datum in --crs.")
    single = [film.name for film in films if (track := tracks[film]) is not None and len(track.times_s) == 1]
    if single:
        notes.append(f"{in_short(single)} say where they began alone: one place a film, which gives no scale (--distance or --height do).")
    return tuple(notes)
