"""Films are read back frame by frame; what fails leaves nothing, and the old film stays."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pictures

from radiant_core.errors import BadInput
from radiant_viewer.pictures.movie import MovieWriter

SIZE_WH = (64, 48)


def frame(level: int) -> np.ndarray:
    image = np.full((48, 64, 3), (level, 40, 200), np.uint8)
    image[:24] = (20, level, 90)
    return image


@pytest.mark.parametrize("ending", [".mp4", ".webm", ".gif"])
def test_a_film_holds_its_frames_in_order_and_colour(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"flight{ending}"
    levels = [10, 90, 170, 250]
    with MovieWriter(path, SIZE_WH, 10) as movie:
        for level in levels:
            movie.add(frame(level))
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    read = _frames(path)
    assert len(read) == 4
    for level, image in zip(levels, read, strict=True):
        # Lossy codecs at their default rate: within 12 of 255 in the middle of an even half.
        assert np.abs(image[40, 32].astype(int) - frame(level)[40, 32]).max() < 12


def test_what_fails_leaves_no_film_and_keeps_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "flight.gif"
    path.write_bytes(b"old")

    def broken_off() -> None:
        with MovieWriter(path, SIZE_WH, 10) as movie:
            movie.add(frame(0))
            movie.add(frame(0)[:10])

    with pytest.raises(BadInput, match="shape"):
        broken_off()
    with pytest.raises(BadInput, match="no frame"), MovieWriter(path, SIZE_WH, 10):
        pass
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
    for wrong, size in ((tmp_path / "a.avi", SIZE_WH), (tmp_path / "a.mp4", (63, 48)), (tmp_path / "none" / "a.mp4", SIZE_WH)):
        with pytest.raises(BadInput):
            MovieWriter(wrong, size, 10)


def _frames(path: Path) -> list[np.ndarray]:
    if path.suffix == ".gif":
        with Pictures.open(path) as film:
            frames = []
            for index in range(getattr(film, "n_frames", 1)):
                film.seek(index)
                frames.append(np.asarray(film.convert("RGB")))
            return frames
    video = cv2.VideoCapture(str(path))
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1][..., ::-1])
    return frames
