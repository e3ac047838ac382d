"""The curves of this machine that forecasts of the start window go by: `python -m
radiant_app.commands.machine.this_machine` makes them, as `radiant machine profile --out FILE` does,
in place of earlier ones. Once per machine, five minutes.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

from radiant_app.interrupts import INTERRUPTED, interrupt_on_signals, stop_repeating_interrupt
from radiant_core.errors import RadiantError

NEXT = "machine_next.toml"


def machine_profile() -> Path:
    """Where they lie, once they were measured."""
    home = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    return home / "radiant" / "machine.toml"


def measure() -> None:
    """Measure this machine, and keep its curves in place of earlier ones; raises as
    `commands.profile`."""
    from radiant_app.commands.machine.profile import ProfileRequest, profile
    from radiant_app.report.progress import terminal_display

    current = machine_profile()
    measured = current.with_name(NEXT)
    current.parent.mkdir(parents=True, exist_ok=True)
    measured.unlink(missing_ok=True)
    with terminal_display() as listen:
        profile(ProfileRequest(out=measured), listen)
    measured.replace(current)


def main() -> int:
    """Measure; returns the exit code."""
    interrupt_on_signals()
    try:
        with suppress(BrokenPipeError):
            measure()
    except RadiantError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        stop_repeating_interrupt()
    return 0


if __name__ == "__main__":
    sys.exit(main())
