"""One Ray cluster for all tests of a session, a head with two CPUs; reports with blank pictures, as in tests/app."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

import pytest

from tests.app.blank_reports import blank_pictures, pictures_of_a_test

from .ray_machines import ray_cluster

__all__ = ["address", "blank_pictures", "pictures_of_a_test"]


@pytest.fixture(scope="session")
def address() -> Iterator[str]:
    """host:port of the cluster's head."""
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed: the extra `cluster` brings it")
    with ray_cluster() as cluster:
        cluster.start("head", num_cpus=2, offers=["edge:a"])
        yield cluster.address
