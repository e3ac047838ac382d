"""What a process can still take, from made-up kernel files of a machine and of containers with a limit."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from radiant_app.workers.memory import UNKNOWN_BYTES, available_bytes

GB = 1_000_000_000


def kernel(folder: Path, cgroup: str) -> tuple[Path, Path]:
    """Files of a machine with 8 GB free."""
    (folder / "proc" / "self").mkdir(parents=True)
    (folder / "proc" / "meminfo").write_text(f"MemTotal: {16 * GB // 1000} kB\nMemAvailable: {8 * GB // 1024} kB\n")
    (folder / "proc" / "self" / "cgroup").write_text(cgroup)
    (folder / "groups").mkdir()
    return folder / "proc", folder / "groups"


def group(folder: Path, files: dict[str, object]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_text(f"{content}\n")


def test_without_a_container_it_is_what_the_machine_has_free(tmp_path: Path) -> None:
    assert available_bytes(*kernel(tmp_path, "0::/\n")) == 8 * GB // 1024 * 1024


@pytest.mark.parametrize(("limit", "expected"), [(4 * GB, 2 * GB), ("max", 8 * GB // 1024 * 1024), (2 * GB, 0)])
def test_a_limit_around_the_process_counts_and_cached_files_are_free(tmp_path: Path, limit: object, expected: int) -> None:
    proc, groups = kernel(tmp_path, "0::/job/step\n")
    group(groups / "job", {"memory.max": limit, "memory.current": 3 * GB, "memory.stat": f"anon {2 * GB}\ninactive_file {GB}"})
    group(groups / "job" / "step", {"memory.max": "max", "memory.current": GB, "memory.stat": "inactive_file 0"})
    assert available_bytes(proc, groups) == expected


@pytest.mark.parametrize(
    ("most", "high", "expected"),
    [("max", 4 * GB, 2 * GB), (6 * GB, 4 * GB, 2 * GB), (4 * GB, 6 * GB, 2 * GB), (4 * GB, "max", 2 * GB), ("max", GB, 0)],
)
@pytest.mark.parametrize("where", ["job/step", "job", ""])
def test_a_limit_beyond_which_all_slows_down_counts_as_one(tmp_path: Path, where: str, most: object, high: object, expected: int) -> None:
    proc, groups = kernel(tmp_path, "0::/job/step\n")
    files = {"memory.max": most, "memory.high": high, "memory.current": 3 * GB, "memory.stat": f"inactive_file {GB}"}
    group(groups / where, files)
    assert available_bytes(proc, groups) == expected


@pytest.mark.parametrize("stat", ["anon 5\n", "", None])
def test_a_limit_counts_also_where_nothing_is_said_of_cached_files(tmp_path: Path, stat: str | None) -> None:
    proc, groups = kernel(tmp_path, "0::/\n")
    files = {"memory.max": 4 * GB, "memory.current": 3 * GB, **({} if stat is None else {"memory.stat": stat})}
    group(groups, files)
    assert available_bytes(proc, groups) == GB


def test_a_limit_of_version_2_beside_version_1_counts(tmp_path: Path) -> None:
    proc, groups = kernel(tmp_path, "3:cpu:/a\n0::/user.slice/job\n")
    group(groups / "unified/user.slice", {"memory.high": 4 * GB, "memory.current": 3 * GB, "memory.stat": "inactive_file 0"})
    assert available_bytes(proc, groups) == GB


@pytest.mark.parametrize("around", ["", "slurm", "slurm/uid_0", "slurm/uid_0/job_7", "slurm/uid_0/job_7/step_0"])
def test_a_limit_of_version_1_counts_wherever_around_the_process_it_is(tmp_path: Path, around: str) -> None:
    proc, groups = kernel(tmp_path, "9:memory:/slurm/uid_0/job_7/step_0\n")
    unlimited = {"memory.limit_in_bytes": 9223372036854771712, "memory.usage_in_bytes": GB, "memory.stat": "total_inactive_file 0"}
    for each in ("", "slurm", "slurm/uid_0", "slurm/uid_0/job_7", "slurm/uid_0/job_7/step_0"):
        group(groups / "memory" / each, unlimited)
    group(groups / "memory" / around, {"memory.limit_in_bytes": 3 * GB})
    assert available_bytes(proc, groups) == 2 * GB


def test_a_container_sees_its_own_group_at_the_root_also_in_version_1(tmp_path: Path) -> None:
    proc, groups = kernel(tmp_path, "5:cpu:/docker/a\n4:memory:/docker/a\n0::/docker/a\n")
    files = {"memory.limit_in_bytes": 3 * GB, "memory.usage_in_bytes": 2 * GB, "memory.stat": "total_inactive_file 500000000"}
    group(groups / "memory", files)
    assert available_bytes(proc, groups) == GB + 500_000_000


def test_broken_kernel_files_are_passed_over(tmp_path: Path) -> None:
    proc, groups = kernel(tmp_path, "nonsense\n0::/job\n")
    group(groups / "job", {"memory.max": "many", "memory.current": "", "memory.stat": "inactive_file"})
    assert available_bytes(proc, groups) == 8 * GB // 1024 * 1024
    (proc / "meminfo").write_text("MemTotal 3\n")
    assert available_bytes(proc, groups) > 0


def test_where_the_system_does_not_tell_there_is_no_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> int:
        raise ValueError(f"unrecognized configuration name {name}")

    monkeypatch.setattr(os, "sysconf", refuse)
    assert available_bytes(tmp_path, tmp_path) == UNKNOWN_BYTES
