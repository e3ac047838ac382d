"""What `radiant machine check` finds, how each lack is mended, and what it says of a run's time."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.machine import doctor
from radiant_app.commands.machine.forecast import duration_text, forecast
from radiant_app.run.predictions import planned_training
from radiant_app.run.this_machine import MEMORY_SHARE
from radiant_core.errors import BadInput
from radiant_core.extras import EXTRAS
from radiant_core.train.memory import training_memory
from radiant_core.train.needs import Overrides

CURVES = """
kind = "measured"
machine = "a test's machine"
source = "made up"
[key]
preset = "default"
num_steps = 1500
long_side_px = 576
[init_s]
constant = 4.0
range = [4, 20]
[train_s]
constant = 10.0
linear = 1.0
range = [4, 20]
[model_bytes]
linear = 1000.0
range = [4, 20]
[aggregate_s]
linear = 0.5
range = [8, 40]
[sfm_s]
linear = 2.0
range = [4, 12]
"""


@pytest.fixture
def curves(tmp_path: Path) -> Path:
    (tmp_path / "machine.toml").write_text(CURVES)
    return tmp_path / "machine.toml"


def room_for(num_photographs: int) -> int:
    """Free bytes with room for one training of so many photographs, and of no more."""
    return round(training_memory(planned_training("default", Overrides()), num_photographs).needed_bytes / MEMORY_SHARE) + 1


def test_a_run_is_one_training_where_memory_holds_it(curves: Path) -> None:
    found = forecast(80, curves, free_bytes=64 * 10**9)
    assert found.parts_s == pytest.approx({"structure from motion": 160.0, "device": 4 + 10 + 80})
    assert found.unknown == ("edge",) and found.shortage is None


@pytest.mark.usefixtures("usual_rounds")
def test_a_run_takes_what_its_stages_take_one_wave_after_another(curves: Path) -> None:
    free = room_for(18)
    found = forecast(80, curves, free_bytes=free)
    workers = 1
    devices_s, edges_s = math.ceil(4 / workers) * (4 + 10 + 20), math.ceil(2 / workers) * 20.0
    # 75 times 80 photographs are 6,000 steps, as four devices take them: one round of 160 steps, 1.4 times as long as in a training.
    round_s = math.ceil(4 / workers) * (1.2 * 4 + 1.4 * 30 * 160 / 1500) + (math.ceil(2 / workers) + 0.5) * 4
    assert found.parts_s == pytest.approx({"structure from motion": 160.0, "devices": devices_s, "edges": edges_s, "refining": round_s})
    more, rounds = forecast(84, curves, free_bytes=room_for(19)).parts_s["refining"], 3
    # An edge counts what photographs show in the first round alone.
    at_edges, devices_s = (1 + 2 * 0.5) * math.ceil(2 / workers) * 4, math.ceil(4 / workers) * (1.2 * 4 + 1.4 * 31 * 168 / 1500)
    assert more == pytest.approx(rounds * (devices_s + 0.5 * 4) + at_edges)
    assert found.unknown == ("cloud",) and found.extrapolated == ("structure from motion",)
    assert found.shortage is None and "unknown: cloud; extrapolated: structure from motion;" in found.text


def test_memory_divides_a_run_and_what_is_too_little_is_said(curves: Path) -> None:
    whole, divided, none = (forecast(4000, curves, free_bytes=round(gigabytes * 1e9)) for gigabytes in (64, 2, 0.4))
    assert "device" in whole.parts_s and "devices" in divided.parts_s
    assert whole.shortage is None and divided.shortage is None
    assert none.shortage is not None and "lower --max-splats or --long-side-px" in none.shortage


def test_every_lack_has_a_line_with_what_mends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "missing_modules", lambda extra: list(EXTRAS[extra].modules))
    monkeypatch.setattr(doctor, "available_bytes", lambda: 10**9)
    for name in doctor.DISPLAY_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    findings = {finding.name: finding for finding in doctor.examine()}
    lacking = [finding for finding in findings.values() if not finding.ok and finding.name != "CUDA device"]
    assert {f"extra {name}" for name in EXTRAS} - {"extra cuda"} <= {finding.name for finding in lacking}
    assert all(finding.advice for finding in lacking)
    lines = doctor.table(list(findings.values())).splitlines()
    assert any("→ " in line and "'radiant-splats[sfm]'" in line for line in lines)
    assert findings["free memory"].advice and "radiant machine profile --out" in findings["a run of 100 photographs"].advice


def test_a_card_that_torch_was_not_built_for_is_named_with_the_way_to_use_it(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", None)
    monkeypatch.setattr(doctor, "_nvidia_card", lambda: "a card")
    found = doctor._cuda()
    assert (
        "a card; not used" in found.found and "install --force-reinstall torch" in found.advice and "'radiant-splats[cuda]'" in found.advice
    )


def test_the_command_takes_a_profile_and_refuses_what_is_none(curves: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["machine", "check", "--photographs", "40", "--profile", str(curves), "--json"])
    rows = {row["name"]: row for row in json.loads(result.stdout)}
    assert rows["a run of 40 photographs"]["found"].startswith("about ") and result.exit_code == 0
    with pytest.raises(BadInput, match="cannot be read"):
        doctor.examine(40, tmp_path / "none.toml")


def test_durations_are_read_at_a_glance() -> None:
    assert [duration_text(seconds) for seconds in (4.4, 89.0, 5400.0)] == ["4 s", "1 min", "1.5 h"]
