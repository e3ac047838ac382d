"""One emulated machine: a command at a share of one core, its product held back as by a slow link.

Started by `EmulatedExecutor` in place of a worker: `… emulated_node BEGUN SPEED BYTES_PER_S STAGE
FOLDER COMMAND…`. Linux only.

    share   with c the command's CPU seconds and t the wall seconds since BEGUN (on the machine's
            monotonic clock: the start of this process costs nothing), it is stopped (SIGSTOP) while
            c − speed · t is large and runs while it is small: the share is of its own CPU time, so
            that other work on this machine delays it but is caught up with
    steps   a machine that trains together with others waits for them in every step: meanwhile it
            keeps to the share itself (`radiant_app/together/playing.py`), and neither its CPU
            seconds nor these seconds count here
    link    a token bucket without burst: byte k of the product arrives at k / bytes_per_s

A stopped process cannot react. The kernel therefore kills the command when this process ends for
any reason (PR_SET_PDEATHSIG), and this process ends when its standard input closes, that is, with
the executor.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from radiant_app.events import UPLINK, Event, StageDone, StageProgress, StageStarted, Warned, encode
from radiant_app.together.playing import AGREED, KEEPS, SHARE, WORKED

PERIOD_S = 0.1
"""One period of running and pausing: shorter costs wake-ups, longer distorts short nodes."""
BUSY_SHARE = 0.85
"""A node that got less than this part of its share is reported: its time depends on the load."""
PRODUCTS = (("upload.safetensors",), ("refined.safetensors", "rows.safetensors"), ("model.safetensors",))
"""The files that a node sends: the first of these groups in its folder."""
PROGRESS_S = 0.5
SHORTEST_S = 1e-3
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def main(arguments: list[str]) -> int:
    """Run the command and deliver its product; the exit code or signal is the command's."""
    begun_s, speed, bytes_per_s = map(float, arguments[:3])
    stage, folder, command = arguments[3], Path(arguments[4]), arguments[5:]
    code, share = _run_at_share(command, speed, begun_s)
    if code < 0:
        if -code != signal.SIGKILL:
            signal.signal(-code, signal.SIG_DFL)
        signal.raise_signal(-code)
    if code:
        return code
    if share < BUSY_SHARE * speed:
        busy = f"it got {share:.2f} of a core instead of {speed:g}: this machine was too busy, so its emulated time is too long."
        _emit(Warned(stage=stage, message=busy))
    _deliver(f"{stage}{UPLINK}", product_bytes(folder), bytes_per_s)
    return 0


def product_bytes(folder: Path) -> int:
    """Bytes that a node sends; 0 for a device that cannot deliver."""
    sizes = ([path.stat().st_size for path in (folder / name for name in names) if path.is_file()] for names in PRODUCTS)
    return sum(next((group for group in sizes if group), []))


@dataclass(kw_only=True)
class _Account:
    """What counts of a command for its share of a core; `kept`: what it did while it kept to the
    share itself."""

    speed: float
    begun_s: float
    apart_s: float = 0.0
    apart_cpu_s: float = 0.0
    kept_s: float = 0.0
    kept_cpu_s: float = 0.0

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.begun_s - self.apart_s

    def ahead_s(self, cpu_s: float) -> float:
        """CPU seconds of the command above its share."""
        return cpu_s - self.apart_cpu_s - self.speed * self.seconds

    def share(self, cpu_s: float) -> float:
        return (cpu_s - self.apart_cpu_s + self.kept_cpu_s) / (self.seconds + self.kept_s)


def _run_at_share(command: list[str], speed: float, begun_s: float) -> tuple[int, float]:
    """Exit code (negative: signal) of the command, and the share of a core that it got."""
    # This process has one thread, so that code between fork and exec is safe.
    kill = _kill_with(os.getpid())
    keeper, member = socket.socketpair()
    fds = [member.fileno()]
    env = {**os.environ, "OMP_NUM_THREADS": "1", SHARE: f"{fds[0]} {speed}"}
    process = subprocess.Popen(command, env=env, preexec_fn=kill, pass_fds=fds)  # noqa: PLW1509
    member.close()
    ended = os.pidfd_open(process.pid)
    account = _Account(speed=speed, begun_s=begun_s)
    half_s, running, wait_s, watched = speed * PERIOD_S / 2, True, 0.0, [ended, keeper.fileno()]
    while ended not in (ready := _wait(wait_s, *watched)):
        if keeper.fileno() in ready:
            if not running:
                signal.pidfd_send_signal(ended, signal.SIGCONT)
            if not _let_keep(account, process.pid, ended, keeper):
                watched = [ended]
            running = True
        ahead_s = account.ahead_s(_cpu_s(process.pid))
        if running != (ahead_s < (half_s if running else -half_s)):
            running = not running
            # Not Popen.send_signal, which collects a process that just ended and its CPU time.
            signal.pidfd_send_signal(ended, signal.SIGCONT if running else signal.SIGSTOP)
        # One thread gains less than a second in a second; stopped, it falls behind by `speed`.
        wait_s = min(max(half_s - ahead_s, SHORTEST_S), PERIOD_S) if running else (ahead_s + half_s) / speed
    os.close(ended)
    keeper.close()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    cpu_s = usage.ru_utime + usage.ru_stime
    _wait(account.ahead_s(cpu_s) / speed)
    return process.returncode, account.share(cpu_s)


def _let_keep(account: _Account, pid: int, ended: int, keeper: socket.socket) -> bool:
    """Let a command keep to its share itself, from when it has not more than that until it says
    what it did; False where it says nothing, since it has ended or only closed its end."""
    try:
        if keeper.recv(len(KEEPS)) != KEEPS:
            return False
        _wait(account.ahead_s(_cpu_s(pid)) / account.speed, ended)
        begun_s, begun_cpu_s = time.monotonic(), _cpu_s(pid)
        keeper.sendall(AGREED)
        _wait(None, ended, keeper.fileno())
        told = keeper.recv(WORKED.size, socket.MSG_DONTWAIT)
    except OSError:
        return False
    if len(told) < WORKED.size:
        return False
    account.kept_cpu_s, account.kept_s = WORKED.unpack(told)
    account.apart_s, account.apart_cpu_s = time.monotonic() - begun_s, _cpu_s(pid) - begun_cpu_s
    with suppress(OSError):
        keeper.sendall(AGREED)
    return True


def _deliver(stage: str, num_bytes: int, bytes_per_s: float) -> None:
    _emit(StageStarted(stage=stage, emulated=True))
    begun_s = time.monotonic()
    total_s = num_bytes / bytes_per_s
    while (passed_s := time.monotonic() - begun_s) < total_s:
        arrived = passed_s * bytes_per_s
        _emit(StageProgress(stage=stage, done=arrived, total=num_bytes, note=f"{arrived / 1e6:.2f} of {num_bytes / 1e6:.2f} MB"))
        _wait(min(PROGRESS_S, total_s - passed_s))
    _emit(StageDone(stage=stage, seconds=time.monotonic() - begun_s, emulated=True))


def _wait(seconds: float | None, *descriptors: int) -> Collection[int]:
    """Wait for `seconds`, None: without end, or until descriptors are readable: these; ends with
    the executor."""
    # The executor holds a pipe open as our standard input and never writes; by hand there is none.
    pipe = [0] if stat.S_ISFIFO(os.fstat(0).st_mode) else []
    ready, _, _ = select.select([*pipe, *descriptors], [], [], None if seconds is None else max(0.0, seconds))
    if 0 in ready:
        os._exit(1)
    return ready


def _cpu_s(pid: int) -> float:
    """CPU seconds of all threads of a process, by its clock, see clock_getcpuclockid(3)."""
    return time.clock_gettime((~pid << 3) | 2)


def _kill_with(parent: int):  # noqa: ANN202 - a plain callable for subprocess
    def before_exec() -> None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)

    return before_exec


def _emit(event: Event) -> None:
    sys.stdout.write(encode(event) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
