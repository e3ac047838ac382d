"""Scores of trials in a file: found again, and nothing that is damaged is used or ends a training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_app.files.score_file import SCORES, ScoreFile


def test_scores_come_back_to_the_bit_and_by_their_key(tmp_path: Path) -> None:
    figures = np.random.default_rng(0).normal(20, 3, 5)
    ScoreFile(tmp_path / SCORES).keep("a", figures)
    ScoreFile(tmp_path / SCORES).keep("b", figures[:2])
    again = ScoreFile(tmp_path / SCORES)
    found = again.find("a")
    assert found is not None and found.tobytes() == figures.tobytes()
    assert again.find("c") is None and len(again.find("b")) == 2  # type: ignore[arg-type]


HUGE = '{"a": [1' + 400 * "0" + "]}"


@pytest.mark.parametrize(
    "text",
    ["", "[1]", '{"a": "x"}', '{"a": [NaN]}', '{"a": []}', '{"a": [[1]]}', '{"a": null}', '{"a": {"b": 1}}', '{"a": ["20.5"]}',
     '{"a": [true]}', HUGE, '{"a": [20.5], "b": [1'],
)  # fmt: skip
def test_what_is_damaged_is_taken_again_with_a_warning(tmp_path: Path, text: str) -> None:
    (tmp_path / SCORES).write_text(text)
    said: list[str] = []
    kept = ScoreFile(tmp_path / SCORES, said.append)
    assert kept.find("a") is None and len(said) == 1 and "is damaged" in said[0]
    kept.keep("a", np.array([20.5]))
    assert kept.find("a") == np.array([20.5]) and ScoreFile(tmp_path / SCORES, said.append).find("a") == np.array([20.5])
    assert len(said) == 1


def test_a_score_that_cannot_be_written_is_a_warning(tmp_path: Path) -> None:
    said: list[str] = []
    kept = ScoreFile(tmp_path / "none" / SCORES, said.append)
    kept.keep("a", np.array([20.5]))
    assert len(said) == 1 and "was not kept" in said[0] and said[0].endswith("Training goes on")
    ScoreFile(tmp_path / SCORES, said.append).keep("a", np.array([np.nan]))
    assert len(said) == 2 and not (tmp_path / SCORES).exists()
