"""Which frames of films are taken: by motion, the sharp ones, as many as asked; and how that goes on after an interruption."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.film import frames as frames_module
from radiant_core.io.film.choosing import LEAST_FRAMES, MOST_FRAMES, blurred_frames, choose_frames
from radiant_core.io.film.formats import films_in, srt_beside
from radiant_core.io.film.frames import take_frames
from radiant_core.io.film.watching import WatchedFrame, motion_between, watch_film
from radiant_core.io.photos.listing import photograph_heads
from tests.core.io.film.films import panned, photographs, shaken, srt, write_film


def quiet(*_: object) -> None:
    pass


def test_motion_is_the_way_of_the_picture_and_frames_are_counted_by_decoding(tmp_path: Path) -> None:
    picture = photographs()[0]
    path = write_film(tmp_path / "pan.mp4", panned(picture, 31, 2.0), rate=30)
    told: list[tuple[int, int]] = []
    watched = watch_film(path, lambda done, total: told.append((done, total)))
    assert [frame.index for frame in watched] == list(range(0, 31, 3)) and told[-1] == (31, 31)
    assert [frame.time_s for frame in watched] == pytest.approx(np.arange(0, 31, 3) / 30, abs=1e-3)
    # Six pixels of 160, tracked in a lossy film to a tenth of a pixel.
    assert [frame.motion for frame in watched[1:]] == pytest.approx([6 / 160] * 10, abs=0.1 / 160)
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    assert motion_between(np.zeros_like(grey), grey) == 1.0, "nothing can be tracked over a cut to a black frame"


def test_blurred_frames_are_passed_over(tmp_path: Path) -> None:
    blurred = [index for index in range(80) if index % 4 in (1, 2)]
    watched = watch_film(write_film(tmp_path / "pan.mp4", panned(photographs()[0], 80, 1.5, blurred)), quiet)
    assert np.flatnonzero(blurred_frames(watched)).tolist() == blurred
    # 119 px are 74 % of the picture: seven tenths, in which every third stretch has a sharp frame.
    chosen = choose_frames({"pan": watched}, num_frames=15)
    taken = [frame.index for frame in chosen.frames["pan"]]
    assert chosen.num_blurred == 40 and chosen.num_blurred_taken == 0 and not set(taken) & set(blurred)
    assert 13 <= len(taken) <= 16 and chosen.reason == "--film-frames is 15"
    moved = np.cumsum([frame.motion for frame in watched])[taken]
    assert (np.diff(moved) < 2 * chosen.step).all()


def steady(num: int, motion: float) -> tuple[WatchedFrame, ...]:
    """Frames that move on evenly, each tenth one the sharpest."""
    return tuple(WatchedFrame(index=3 * i, time_s=0.1 * i, sharpness=100 + (i % 10 == 4), motion=motion * (i > 0)) for i in range(num))


@pytest.mark.parametrize(
    ("num", "motion", "count", "told"),
    [
        (2000, 0.01, 200, "neighbours overlap by nine tenths"),
        (9000, 0.01, MOST_FRAMES, "would take 900 frames, and 400 are the most"),
        (900, 0.002, LEAST_FRAMES, "would take 18 frames, fewer than 60"),
        (40, 0.002, 8, "less than a hundredth of the picture apart show the same"),
    ],
)
def test_the_number_of_frames_follows_motion_within_limits_that_are_told(num: int, motion: float, count: int, told: str) -> None:
    chosen = choose_frames({"a": steady(num, motion)})
    # One stretch more or less at the ends.
    assert abs(chosen.num_taken - count) <= 1 and told in chosen.reason
    if count == 200:
        assert chosen.step == pytest.approx(0.1, rel=1e-3)
        assert sum(frame.sharpness > 100 for frame in chosen.frames["a"]) >= 199


def test_frames_of_two_films_share_the_number_by_motion() -> None:
    chosen = choose_frames({"long": steady(3000, 0.01), "short": steady(1000, 0.01)}, num_frames=100)
    assert len(chosen.frames["long"]) == pytest.approx(75, abs=1) and len(chosen.frames["short"]) == pytest.approx(25, abs=1)


def test_frames_carry_the_positions_of_the_subtitles_and_are_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    film = write_film(tmp_path / "source" / "DJI_0001.MP4", shaken(photographs()))
    blocks = [(0.1 * index, f"[latitude: {47 + 1e-4 * index:.6f}] [longitude: 8.5] [rel_alt: 1 abs_alt: 430.5]") for index in range(36)]
    film.with_suffix(".SRT").write_text(srt(blocks))
    assert srt_beside(film) == film.with_suffix(".SRT") and films_in(film.parent) == films_in(film) == (film,)
    told: list[tuple[str, int, int]] = []
    taken = take_frames([film], tmp_path / "frames", 12, lambda *report: told.append(report))
    assert list(dict.fromkeys(phase for phase, _, _ in told)) == ["watching films", "taking frames"]
    assert told[-1][1:] == (100, 100)
    heads = photograph_heads(taken.folder)
    indices = [int(match[1]) for name in heads if (match := re.fullmatch(r"film_DJI_0001/DJI_0001_(\d{6})\.jpg", name))]
    # The sharp one of each three; a cut that moves on by more than a step leaves one stretch empty.
    assert len(heads) == len(indices) >= 11 and [index % 3 for index in indices] == [1] * len(heads)
    for index, head in zip(indices, heads.values(), strict=True):
        assert head.lat_lon_alt == pytest.approx((47 + 1e-4 * index, 8.5, 430.5), abs=1e-7)
    assert taken.decision.choice == f"{len(heads)} of 36 frames that were looked at, the sharpest of each stretch" and taken.decision.forced
    assert re.search(r"\d+ of them blurred, of which 0 are taken for want of sharp ones$", taken.decision.reason)
    said, heights = taken.warnings
    assert said == f"DJI_0001.MP4: {taken.decision.choice}; 1 of 1 films have positions."
    assert heights == "heights that are written for a film may be off by tens of metres: name no vertical datum in --crs."
    before = {path: path.stat().st_mtime_ns for path in taken.folder.rglob("*.jpg")}
    first = sorted(before)[0]
    first.unlink()
    monkeypatch.setattr(frames_module, "watch_film", lambda *_: pytest.fail("a film is looked at once"))
    again = take_frames([film], tmp_path / "frames", 12, quiet)
    assert again.decision == taken.decision and first.is_file()
    assert {path: path.stat().st_mtime_ns for path in taken.folder.rglob("*.jpg") if path != first} == {
        path: time for path, time in before.items() if path != first
    }
    monkeypatch.undo()
    assert len(list(take_frames([film], tmp_path / "frames", 6, quiet).folder.rglob("*.jpg"))) < 12


def test_what_makes_no_photographs_gets_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + bytes(400))
    with pytest.raises(BadInput, match=r"broken\.mp4 cannot be opened"):
        take_frames([tmp_path / "broken.mp4"], tmp_path / "frames", None, quiet)
    still = write_film(tmp_path / "still.mp4", [photographs()[0]] * 20)
    with pytest.raises(BadInput, match=r"still\.mp4 moves by \d+ % of its picture in all, which makes 1 photographs"):
        take_frames([still], tmp_path / "frames", None, quiet)
    twin = write_film(tmp_path / "other" / "STILL.mov", [photographs()[0]] * 3)
    with pytest.raises(BadInput, match="have one name"):
        take_frames([still, twin], tmp_path / "frames", None, quiet)
    assert not (tmp_path / "frames").exists()
