"""No signal of ours reaches a process that is no run's: numbers are checked in one place, and nothing else signals by number."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from radiant_app.executors import sessions
from radiant_app.executors.sessions import signal_session
from radiant_core.errors import StageFailed

ROOT = Path(__file__).parents[2]
PACKAGES = ("core/radiant_core", "viewer/radiant_viewer", "radiant_app", "sample_scenes", "tools")
BY_NUMBER = {"kill", "killpg", "pthread_kill", "pidfd_send_signal", "tgkill"}
MODULES = {"os", "signal", "_LIBC", "psutil"}
ALLOWED = {
    "radiant_app/executors/sessions.py": {"killpg"},
    # By a descriptor of the process that it has started itself.
    "radiant_app/executors/emulated_node.py": {"pidfd_send_signal"},
    # By a descriptor of the process that holds the run's lock.
    "radiant_app/commands/run/control.py": {"pidfd_send_signal"},
}


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Signals that would have been sent."""
    signals: list[tuple[int, int]] = []
    monkeypatch.setattr(sessions.os, "killpg", lambda pid, number: signals.append((pid, number)))
    return signals


@pytest.mark.parametrize("pid", [1, 0, -1, -2, -(2**31)])
def test_a_number_that_means_more_than_one_process_is_not_signalled(pid: int, sent: list[tuple[int, int]]) -> None:
    with pytest.raises(StageFailed, match=f"process {pid} leads no session of this run and was sent no SIGTERM: `ps` shows"):
        signal_session(pid, signal.SIGTERM)
    assert sent == []


@pytest.mark.parametrize("whose", ["itself", "its session", "a child of its session"])
def test_a_session_that_is_this_process_s_is_not_signalled(whose: str, sent: list[tuple[int, int]]) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        pid = {"itself": os.getpid(), "its session": os.getsid(0), "a child of its session": child.pid}[whose]
        with pytest.raises(StageFailed, match="leads no session of this run"):
            signal_session(pid, signal.SIGKILL)
        child.communicate(b"\n")
    assert sent == []


def test_a_session_of_its_own_is_signalled_and_one_that_ended_is_not() -> None:
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, start_new_session=True)
    signal_session(process.pid, signal.SIGTERM)
    process.communicate()
    assert process.returncode == -signal.SIGTERM
    signal_session(process.pid, signal.SIGTERM)


def calls_by_number(source: Path) -> set[str]:
    """Names of the calls in a file that signal processes by number."""
    calls = (node.func for node in ast.walk(ast.parse(source.read_text())) if isinstance(node, ast.Call))
    attributes = (call for call in calls if isinstance(call, ast.Attribute) and call.attr in BY_NUMBER)
    return {call.attr for call in attributes if isinstance(call.value, ast.Name) and call.value.id in MODULES}


def test_nothing_else_of_the_product_signals_by_number() -> None:
    sources = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    signalling = {str(path.relative_to(ROOT)): names for path in sources if (names := calls_by_number(path))}
    assert signalling == ALLOWED
    imported = [
        path
        for path in sources
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom)
        if node.module in MODULES and {name.name for name in node.names} & BY_NUMBER
    ]
    assert imported == []
