"""Machines whose clocks are wrong, and two processes of one."""

from __future__ import annotations

import shutil
import subprocess
import threading
from pathlib import Path

import pytest

from radiant_app.commands.network import node as commands
from radiant_app.network.certificate import make_certificate
from radiant_app.network.home import make_home
from radiant_core.errors import BadInput
from tests.app.network_transfer import make_edge

SINCE_1970_S = {"no battery": 0, "1999": 9 * 10**8, "2262": 9223372036, "9000": 222 * 10**9}


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
@pytest.mark.parametrize("clock", SINCE_1970_S)
def test_a_certificate_holds_whatever_the_clock_says(tmp_path: Path, clock: str) -> None:
    path = tmp_path / "certificate.pem"
    path.write_bytes(make_certificate(make_home(tmp_path / "home", None).key))
    command = ["openssl", "verify", "-attime", str(SINCE_1970_S[clock]), "-CAfile", str(path), str(path)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0 and "OK" in found.stdout, found.stderr


def test_a_second_process_of_a_node_is_refused_in_a_sentence(tmp_path: Path) -> None:
    make_edge(tmp_path, 8443, 8443, ["d"])
    (tmp_path / "photos").mkdir()
    ended, at_work = threading.Event(), threading.Event()
    first = commands.Running(say=lambda text: at_work.set(), ended=ended)
    working = threading.Thread(target=first.work, args=(tmp_path / "d", tmp_path / "photos", None, lambda text: True), daemon=True)
    working.start()
    try:
        assert at_work.wait(60)
        with pytest.raises(BadInput, match="devices/d is at work already, in another process"):
            commands.Running(ended=threading.Event()).work(tmp_path / "d", tmp_path / "photos", None, lambda text: True)
    finally:
        ended.set()
        working.join(30)
    assert not working.is_alive()
