"""Fed3DGS's merge against plans by the number of clients: fleets of the right size, and times that follow from the assumptions."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

import radiant_app
from radiant_app.bench.fed3dgs import IMAGES_PER_CLIENT, MERGE_CONSTANT_S, MERGE_S_PER_IMAGE, bench_fed3dgs, methods_s, repeated_system
from radiant_app.bench.runner import BenchOptions, run_bench
from radiant_app.files.system_file import load_system
from radiant_core.errors import BadInput

SYSTEM = load_system(Path(radiant_app.__file__).parent / "systems" / "paper_1.toml")


def test_a_fleet_repeats_the_system_and_one_server_ends_after_all_its_merges() -> None:
    for num_clients in (1, 4, 5, 33):
        fleet = repeated_system(SYSTEM, num_clients)
        assert len(fleet.devices) == num_clients
        assert [d.train_s for d in fleet.devices] == [SYSTEM.devices[i % len(SYSTEM.devices)].train_s for i in range(num_clients)]
        seconds = methods_s(fleet, num_clients, 1.0, with_paper=False)
        merge_s = MERGE_CONSTANT_S + MERGE_S_PER_IMAGE * IMAGES_PER_CLIENT
        assert seconds["fed3dgs"] >= num_clients * merge_s
        assert seconds["fed3dgs_4"] <= seconds["fed3dgs"] and seconds["exact"] <= seconds["even"] * (1 + 1e-9)
    # From 33 clients on the server never waits but for the first: 480 s to train and send, then one merge after another.
    first_s = min(float(d.init_s(150) + d.train_s(150) + d.model_bytes(150) / d.uplink_bytes_per_s) for d in SYSTEM.devices)
    assert seconds["fed3dgs"] == pytest.approx(first_s + 33 * merge_s, rel=1e-9)


def test_the_benchmark_writes_figures_with_bands_and_a_picture(tmp_path: Path) -> None:
    metrics = {metric.key: metric.value for metric in bench_fed3dgs(True, tmp_path / "fleet.png")}
    for system in (1, 2):
        for clients in (4, 16):
            for method in ("exact", "even", "fed3dgs"):
                key = f"fed3dgs.system{system}.{clients}.{method}"
                assert 0 < metrics[f"{key}.p5_s"] <= metrics[f"{key}.p95_s"]
    picture = cv2.imread(str(tmp_path / "fleet.png"))
    assert picture is not None and (picture != 255).any(axis=2).mean() > 0.01
    with pytest.raises(BadInput, match="--plot is for the benchmarks train, plan, methods and fed3dgs"):
        run_bench("raster", None, BenchOptions(plot=tmp_path / "x.png"))
