"""How far distances that `radiant measure` gives are from those that the generator knows.

    python sample_scenes/measure_error.py RUN [--known FOLDER] [--pairs 500]

Pairs of places of the flown area, drawn at random, at least 10 m apart; each is found on the run's
map where the truth's surface lies, its height read from the run's own surface. The scale of the
run's frame, by GPS of 1 m, counts in full. Prints errors in per cent and how many lie within the σ
that is given.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from radiant_app.commands.survey.measure import accuracy_of, surface_for_measures
from radiant_app.commands.survey.parts import load_survey
from radiant_app.report.progress import terminal_display
from radiant_core.survey.measures import measure
from truth import load_truth

MIN_APART_M = 10.0


def main() -> None:
    """Measure many distances of one run and print their errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--known", type=Path, default=Path(__file__).parent / "town" / "known")
    parser.add_argument("--pairs", type=int, default=500)
    chosen = parser.parse_args()
    survey = load_survey(chosen.run)
    truth, surface, accuracy = (
        load_truth(chosen.known, survey.run.scene),
        surface_for_measures(survey, None, terminal_display()),
        accuracy_of(survey),
    )
    half = np.array(truth.config.extent_m) / 2
    places = np.random.default_rng(0).uniform(-half, half, (2 * chosen.pairs, 2))
    points = np.column_stack([places, truth.heights(places)])
    on_map = survey.map_frame.from_world(truth.truth_from_run.inverse().apply(points))
    errors, within = [], []
    for ends, true in zip(on_map[:, :2].reshape(-1, 2, 2), points.reshape(-1, 2, 3), strict=True):
        distance = float(np.linalg.norm(true[1] - true[0]))
        if distance < MIN_APART_M or not np.isfinite(surface.at(ends)[0]).all():
            continue
        told = measure("distance", ends, surface, accuracy).figures[0]
        errors.append(100 * (told.value / distance - 1))
        within.append(abs(told.value - distance) < told.sigma)
    absolute = np.abs(errors)
    shares = f"median {np.median(absolute):.2f} %, 95 % {np.quantile(absolute, 0.95):.2f} %, below 0.5 %: {(absolute < 0.5).mean():.1%}"
    print(f"{len(errors)} distances: |error| {shares}; within σ: {np.mean(within):.0%}; bias {np.median(errors):+.2f} %")


if __name__ == "__main__":
    main()
