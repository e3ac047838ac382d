"""What becomes of a command when the world around it breaks: its streams, its working folder, its memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

TELLS = """
import sys
from radiant_app.commands.machine import doctor
from radiant_app.cli.app import main
from radiant_app.events import Warned
from radiant_app.report.progress import terminal_display

def examine(*_):
    # As a run tells where it stands: much more than any buffer holds.
    with terminal_display() as tell:
        for number in range(3000):
            tell(Warned(stage="devices/a", message=f"warning {number}"))
    open(place, "w").write("done")
    return []

doctor.examine, place = examine, sys.argv[1]
sys.argv = ["radiant", "machine", "check"]
main()
"""
FAILS = """
import sys
from radiant_app.commands.machine import doctor
from radiant_app.cli.app import main

def examine(*_):
    raise {error}

doctor.examine = examine
sys.argv = ["radiant", "machine", "check"]
main()
"""


def ended(script: str, *arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, text=True, timeout=120, check=False, **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options})


def test_a_log_on_a_full_disk_ends_no_command(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    with Path("/dev/full").open("w") as full:
        process = ended(TELLS, tmp_path / "done", stderr=full)
    assert process.returncode == 0 and (tmp_path / "done").read_text() == "done"


def test_a_reader_that_goes_away_ends_no_command(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    process = ended(TELLS, tmp_path / "done", stdout=writing, stderr=writing)
    os.close(writing)
    assert process.returncode == 0 and (tmp_path / "done").read_text() == "done"


def test_a_result_that_cannot_be_written_is_an_error() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    script = "import sys; from radiant_app.cli.app import main; sys.argv = ['radiant', '--help']; main()"
    with Path("/dev/full").open("w") as full:
        process = ended(script, stdout=full)
    assert process.returncode == 2 and "No space left" in process.stderr and "Traceback" not in process.stderr


@pytest.mark.parametrize("option", [["--out", "made"], ["--out=made"]])
def test_a_result_that_cannot_be_printed_says_where_it_lies(option: list[str], tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    script = f"""
import sys
from pathlib import Path
from radiant_app.commands.run import steps as commands
from radiant_app.cli.app import main

def sfm(source, out, *others, **options):
    out.mkdir()
    return {{"cameras": 3, "unregistered": []}}

commands.sfm = sfm
sys.argv = ["radiant", "sfm", "photos", *{option!r}]
main()
"""
    with Path("/dev/full").open("w") as full:
        process = ended(script, stdout=full, cwd=tmp_path)
    told = "radiant: the result could not be printed (No space left on device): it lies in made.\n"
    assert (process.returncode, process.stderr) == (2, told)


def test_a_working_folder_that_is_gone_gets_one_sentence(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    script = (
        "import os, sys; from radiant_app.cli.app import main; os.rmdir(os.getcwd()); sys.argv = ['radiant', 'machine', 'check']; main()"
    )
    gone.mkdir()
    process = ended(script, cwd=gone)
    assert (process.returncode, process.stderr.count("\n")) == (2, 1) and "does not exist any more" in process.stderr


TORCH = "DefaultCPUAllocator: can't allocate memory: you tried to allocate 4000000000000000 bytes. Error code 12 (Cannot allocate memory)"


@pytest.mark.parametrize("error", ["__import__('numpy').empty(10**15)", f'RuntimeError("{TORCH}")'])
def test_memory_that_does_not_suffice_gets_one_sentence(error: str) -> None:
    process = ended(FAILS.format(error=error))
    assert (process.returncode, process.stderr.count("\n")) == (1, 1) and "not enough memory" in process.stderr


def test_other_errors_of_ours_still_show_where_they_are() -> None:
    process = ended(FAILS.format(error="RuntimeError('a bug')"))
    assert process.returncode == 1 and "Traceback" in process.stderr and "a bug" in process.stderr
