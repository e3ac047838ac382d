#!/usr/bin/env bash
# flip-evaluator: pictures of bytes, or with an alpha channel, are scored without a word, wrongly.
#
# `evaluate` scores arrays of floats, 0 to 1. Pictures come from OpenCV, Pillow or imageio as bytes:
# 0 to 255 are taken as they are and clamped, so that whatever is not 0 is full intensity, and all
# that is compared is which values are 0. Values of a fourth channel are taken for the next pixel's
# red: with alpha beside the colours another picture is scored, and a quarter of the pixels not at
# all. Both return a plausible mean.
# It matters to benchmarks of novel views, whose tables have a column of FLIP: divide by 255, give
# three channels, and check one score of a pair by the command line's.
# Seen on 2026-12-01 with flip-evaluator 1.7: "floats 0.1126, bytes / 255 0.1126, bytes 0.1361,
# bytes clamped to 0 and 1 0.1361, with alpha 0.0895".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "flip-evaluator==1.7" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import flip_evaluator
import numpy as np


def mean_flip(reference: np.ndarray, test: np.ndarray) -> float:
    return flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False)[1]


def with_alpha(picture: np.ndarray) -> np.ndarray:
    return np.concatenate([picture, np.ones_like(picture[..., :1])], axis=2)


random = np.random.default_rng(0)
reference = random.random((120, 160, 3)).astype(np.float32)
test = np.clip(reference + 0.05 * random.standard_normal(reference.shape), 0, 1).astype(np.float32)
bytes_of = [np.rint(255 * picture).astype(np.uint8) for picture in (reference, test)]
scores = {
    "floats": mean_flip(reference, test),
    "bytes / 255": mean_flip(*(picture / np.float32(255) for picture in bytes_of)),
    "bytes": mean_flip(*bytes_of),
    "bytes clamped to 0 and 1": mean_flip(*(np.minimum(picture, 1).astype(np.float32) for picture in bytes_of)),
    "with alpha": mean_flip(with_alpha(reference), with_alpha(test)),
}
print(", ".join(f"{name} {score:.4f}" for name, score in scores.items()))
same = abs(scores["floats"] - scores["bytes / 255"]) < 1e-3 and scores["bytes"] == scores["bytes clamped to 0 and 1"]
wrong = abs(scores["bytes"] - scores["floats"]) > 0.01 and abs(scores["with alpha"] - scores["floats"]) > 0.005
sys.exit(0 if same and wrong else 1)
PYTHON
