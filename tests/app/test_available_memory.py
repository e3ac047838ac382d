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
