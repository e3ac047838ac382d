"""Keeps the version of a run's scene that is best in photographs that were in no training. Once per
run, with its scoring.

    versions ─ score, compare ─┬─→ the first is the best: it is scored
                               └─→ another one is: that is kept, and scored in its place

The photographs that choose are those that report the score. Where the usual version is kept, the
score is what it would be without a choice; where not, the choice favours the one that is kept, and
metrics.json has the figures of all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from radiant_app.events import Decided, Listener, Warned
from radiant_app.run.dealing import Dealer
from radiant_app.workers.score_files import SCENE_NAME
from radiant_app.workers.scores import versions_of
from radiant_core.choices import Version
from radiant_core.errors import BadInput
from radiant_core.hierarchy.choosing import CUT, choose_version, is_comparison
from radiant_core.hierarchy.join_limits import JOIN_AGAIN, UNREFINED_CUT_COSTS
from radiant_core.io.ply import load_ply
from radiant_core.io.run_store import read_json

STAGE = "evaluation"
NOBODY_REFINED = "the models only faded, for devices to refine them, and none did: the scene is what is cut at their borders."
Score = Callable[[Mapping[Version, Path]], Mapping[str, Path]]
"""Scores the first of several versions and compares all: files of scores by machine."""


def keep_best(dealer: Dealer, score: Score, listen: Listener) -> tuple[Mapping[str, Path], dict[str, Any]]:
    """Compare the versions of the scene and keep the best one, `dealer.version`.

    A machine that does not compare what was asked for is left out with a warning: none can end the
    run of all.

    Returns:
        Machine → file of the scores of that version; what metrics.json says of the choice.
    """
    dealer.chosen = None
    scenes: dict[Version, Path] = {name: folder / SCENE_NAME for name, folder in dealer.versions.items()}
    if next(iter(scenes)) == CUT:
        listen(Warned(stage=STAGE, message=f"{NOBODY_REFINED} {UNREFINED_CUT_COSTS} {JOIN_AGAIN}."))
    scores = dict(score(scenes))
    compared = {machine: versions_of(_record_in(path)) or {} for machine, path in scores.items()}
    for machine, figures in list(compared.items()):
        if len(scenes) > 1 and not is_comparison([*scenes], figures):
            message = f"{machine} does not compare the versions of the scene that it was asked to: its figures are left out."
            listen(Warned(stage=STAGE, message=message))
            del compared[machine], scores[machine]
    choice = choose_version([*scenes], [*compared.values()])
    if choice is None:
        return scores, _facts(dealer.version, scenes)
    decision = choice.decision(STAGE)
    listen(Decided(decision=decision))
    facts = _facts(choice.version, scenes) | {"versions": dict(choice.mean_db)}
    if choice.keeps_usual:
        return scores, facts
    listen(Warned(stage=STAGE, message=f"{decision.choice}, not the {next(iter(scenes))} one: {decision.reason}."))
    dealer.chosen = choice.version
    return score({choice.version: scenes[choice.version]}), facts


def _record_in(path: Path) -> Any:
    """What stands in a file of scores; None where that cannot be read."""
    try:
        return read_json(path, ("versions",))
    except BadInput:
        return None


def _facts(version: Version, scenes: Mapping[Version, Path]) -> dict[str, Any]:
    # The cloud's summary counts the joined one, whose rows the refined one keeps.
    counted = {"num_gaussians": len(load_ply(scenes[version]))} if version == CUT else {}
    return {"version": version, **counted}
