#!/usr/bin/env bash
# OpenCV: in a film of varying rate, `set(CAP_PROP_POS_FRAMES, n)` leads to another frame than the
# n-th.
#
# Telephones and screen recorders write films whose frames are not evenly spaced. OpenCV turns a
# frame's number into a time by the mean rate and looks for that time, so `read` after seeking to n
# gives a frame that may be several away; `set` returns True, and `CAP_PROP_POS_FRAMES` then says n
# + 1, as if it were right. Read from the start, the frames come in order and whole; in a film of
# constant rate seeking is right too.
# It matters to who takes key frames by number and joins them to a track of positions by number:
# pictures and positions are shifted against each other, differently along the film. Read on, and
# use the time stamps.
# Seen on 2026-11-29 with opencv-contrib-python-headless 5.0.0.93, films made by PyAV 16.0.1:
# "constant.mp4: 0 of 80 wrong, by up to 0 frames", "varying.mp4: 49 of 80 wrong, by up to 6 frames;
# set refused 0 times; the number after it was n + 1 80 times".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "opencv-contrib-python-headless==5.0.0.93" "av==16.0.1" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
from fractions import Fraction

import av
import cv2
import numpy as np

NUM_FRAMES, MS = 80, Fraction(1, 1000)


def write_film(path: str, gaps_ms: list[int]) -> None:
    """Write frames that show their number as eight stripes, black or white, with these gaps between."""
    with av.open(path, "w") as film:
        stream = film.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 160, 96, "yuv420p", 2_000_000
        stream.codec_context.time_base = MS
        for number, time_ms in enumerate(np.cumsum([0, *gaps_ms])):
            bits = np.array([255 * (number >> bit & 1) for bit in range(8)], dtype=np.uint8)
            picture = np.tile(np.repeat(bits, 20)[None, :, None], (96, 1, 3))
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = int(time_ms), MS
            film.mux(stream.encode(frame))
        film.mux(stream.encode())


def number_of(picture: np.ndarray) -> int:
    return sum(int(picture[48, 20 * bit + 10].mean() > 128) << bit for bit in range(8))


def seek_errors(path: str) -> list[int]:
    """Frames between the one asked for and the one read, for each number."""
    film = cv2.VideoCapture(path)
    in_order = [number_of(film.read()[1]) for _ in range(NUM_FRAMES)]
    assert in_order == list(range(NUM_FRAMES))
    errors, refused, told = [], 0, 0
    for number in range(NUM_FRAMES):
        refused += not film.set(cv2.CAP_PROP_POS_FRAMES, number)
        errors.append(abs(number_of(film.read()[1]) - number))
        told += int(film.get(cv2.CAP_PROP_POS_FRAMES)) == number + 1
    print(f"{path}: {np.count_nonzero(errors)} of {NUM_FRAMES} wrong, by up to {max(errors)} frames;", end=" ")
    print(f"set refused {refused} times; the number after it was n + 1 {told} times")
    return errors


cv2.setNumThreads(1)
print(f"OpenCV {cv2.__version__}, PyAV {av.__version__}")
write_film("constant.mp4", [33] * (NUM_FRAMES - 1))
write_film("varying.mp4", np.random.default_rng(1).choice([33, 33, 66, 200], NUM_FRAMES - 1).tolist())
constant, varying = seek_errors("constant.mp4"), seek_errors("varying.mp4")
sys.exit(0 if not any(constant) and np.count_nonzero(varying) > 20 and max(varying) > 2 else 1)
PYTHON
