"""A command that gets no memory ends in one sentence."""

from __future__ import annotations

import signal

import pytest

from radiant_app.cli import app as cli


def test_a_command_that_gets_no_memory_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def without_memory(*_: object, **__: object) -> None:
        raise MemoryError

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)}
    monkeypatch.setattr(cli, "app", without_memory)
    try:
        with pytest.raises(SystemExit) as ended:
            cli.main()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    told = capsys.readouterr().err
    assert ended.value.code == 1 and told.startswith("radiant: not enough memory") and told.count("\n") == 1
