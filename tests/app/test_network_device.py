"""What a device says of a worker's end tells nothing of the folders of its owner."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from radiant_app.events import Warned, encode
from radiant_app.network.device import HIDDEN_PLACE, DevicePerformer
from radiant_app.network.home import accept_invitation, invitation_text, make_home, new_invitation
from radiant_core import __version__
from radiant_core.io.transport.envelope import Envelope
from tests.app.network_nodes import listening

RUN = "3" * 32


@pytest.mark.parametrize("folder", ["Anna's wedding", 'quoted "é"'])
def test_no_path_of_its_owner_is_in_what_a_device_says(tmp_path: Path, folder: str) -> None:
    own = tmp_path / folder
    photographs = own / "photographs"
    photographs.mkdir(parents=True)
    cloud = make_home(tmp_path / "cloud", listening())
    edge = make_home(tmp_path / "edge", listening())
    (tmp_path / "edge.join").write_text(invitation_text(new_invitation(cloud, "north")))
    accept_invitation(edge, tmp_path / "edge.join")
    (tmp_path / "d.join").write_text(invitation_text(new_invitation(edge, "d")))
    home = make_home(own / "node", None)
    accept_invitation(home, tmp_path / "d.join")
    warned = encode(Warned(stage="devices/d/count", message=f"{photographs} holds nothing"))
    script = f"print({warned!r}, flush=True); raise SystemExit(9)"
    performer = DevicePerformer(home=home, photographs=photographs, command=lambda task: [sys.executable, "-c", script])
    envelope = Envelope(
        run=RUN,
        sender="edges/north",
        receiver="devices/d",
        kind="count",
        stage="devices/d/count",
        attempt=1,
        answers="",
        software=__version__,
        files={},
    )
    work = performer.begin(envelope, performer.place(envelope), envelope.digest)
    events = []
    until_s = time.monotonic() + 20
    while work.outcome() is None:
        events += work.heard()
        assert time.monotonic() < until_s
        time.sleep(0.01)
    work.stop()
    outcome = work.outcome()
    assert outcome is not None and outcome.crashed and outcome.error is not None
    assert [event.message for event in events] == [f"{HIDDEN_PLACE} holds nothing"]
    assert HIDDEN_PLACE in str(outcome.error) and folder not in str(outcome.error) and str(tmp_path) not in str(outcome.error)
