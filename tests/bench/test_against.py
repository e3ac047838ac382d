"""Two builds in turns: each command runs as often as asked, a cost is the command's, rows resume."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks import against
from radiant_core.errors import BadInput

SCRIPT = """#!{python}
import json, pathlib, sys, time
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
with (out.parent / "order.txt").open("a") as order:
    order.write("{name} ")
held = bytearray({megabytes} * 1_000_000)
until = time.process_time() + {cpu_s}
while time.process_time() < until:
    pass
time.sleep(0.5)
out.mkdir()
(out / "metrics.json").write_text(json.dumps({{"psnr_db": 20.0, "psnr_cc_db": 21.0, "num_gaussians": {megabytes}}}))
"""


def _radiant(path: Path, name: str, megabytes: int, cpu_s: float) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(SCRIPT.format(python=sys.executable, name=name, megabytes=megabytes, cpu_s=cpu_s))
    path.chmod(0o755)
    return path


@pytest.fixture
def builds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The other build; this one's `radiant` lies beside the interpreter that runs the benchmark."""
    other, this = _radiant(tmp_path / "other/radiant", "other", 200, 0.6), _radiant(tmp_path / "this/radiant", "this", 50, 0.1)
    monkeypatch.setattr(sys, "executable", str(this.with_name("python")))
    return other


def test_builds_take_turns_and_their_medians_stand_beside_each_other(builds: Path, tmp_path: Path) -> None:
    arguments = ["--other", str(builds), "--scene", str(tmp_path), "--out", str(tmp_path / "out"), "--rounds", "2"]
    ended = CliRunner().invoke(against.app, arguments)
    assert ended.exit_code == 0, ended.output
    assert (tmp_path / "out/order.txt").read_text().split() == ["other", "this", "this", "other"]
    rows = {name: float(ratio) for name, _, _, ratio in (line.strip("| ").split(" | ") for line in ended.output.splitlines()[-6:])}
    assert rows["num_gaussians"] == 0.25 and rows["psnr_db"] == 1.0
    assert rows["cpu_s"] < 0.6 and rows["peak_bytes"] < 0.6 and rows["wall_s"] < 1
    # A later call measures nothing again.
    assert CliRunner().invoke(against.app, arguments).output == ended.output
    assert len((tmp_path / "out/order.txt").read_text().split()) == 4


def test_a_command_that_fails_is_named_with_its_log(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"ended with 1: .*run\.log holds its words"):
        against.measure(["false"], tmp_path / "run")
