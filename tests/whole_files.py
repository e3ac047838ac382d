"""Whole files for the workers of pytest-xdist, so that what a module's fixtures make is made once.

`--dist loadfile` with two more rules: files that share what a session makes go to one worker, and
files of tests/core, most of which are short, come last, so that the workers end together.
"""

from __future__ import annotations

from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

_FILES = {
    "address": ("contract", ("executors", "gangs", "hierarchy", "together")),
    "finished": ("app", ("cards", "pipeline", "pipeline_commands", "pipeline_nodes")),
    "paper_models": ("bench", ("latency", "paper")),
}
SHARED = {fixture: tuple(f"tests/{folder}/test_{name}.py" for name in names) for fixture, (folder, names) in _FILES.items()}
"""Files by the session's fixture that they ask for, where that takes seconds: a Ray cluster, a run, models."""
_FIXTURE_OF = {file: fixture for fixture, files in SHARED.items() for file in files}
LAST = "tests/core/"


class WholeFiles(LoadFileScheduling):
    """Deals files in the order in which they were collected."""

    def schedule(self) -> None:
        """Deal; the largest file first, xdist's usual order, would put one long test at the end."""
        self.config.option.loadscopereorder = False
        super().schedule()

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return _FIXTURE_OF.get(file, file)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests of short files last; `sort` keeps the order of all others."""
    items.sort(key=lambda item: item.nodeid.startswith(LAST))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> WholeFiles | None:
    """The scheduler of `--dist loadfile`, which each test's file must be dealt by."""
    return WholeFiles(config, log) if config.getoption("dist") == "loadfile" else None
