"""A test of many seeds as one test."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

Test = Callable[..., None]


def for_seeds(count: int) -> Callable[[Test], Test]:
    """Call a test with every `seed` below `count`; a failure names its seed.

    As a parameter of pytest, each of the planner's 2,000 seeds costs some 4 ms in the worker and in
    the process that collects its reports, more than most of them compute.
    """

    def decorate(test: Test) -> Test:
        @functools.wraps(test)
        def run(**given: Any) -> None:
            for seed in range(count):
                try:
                    test(seed=seed, **given)
                except BaseException as error:
                    error.add_note(f"with seed {seed}")
                    raise

        signature = inspect.signature(test)
        others = [parameter for name, parameter in signature.parameters.items() if name != "seed"]
        vars(run)["__signature__"] = signature.replace(parameters=others)
        return run

    return decorate
