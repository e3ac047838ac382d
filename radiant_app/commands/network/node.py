"""What `radiant node` does: this machine as one of several that meet over a network."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.files.out_folder import folder_made_for
from radiant_app.network.home import (
    Home,
    Identity,
    Invitation,
    Listening,
    accept_invitation,
    invitation_text,
    make_home,
    new_invitation,
    open_home,
    write_private,
)
from radiant_app.network.overview import NodeRow, read_rows
from radiant_app.network.serving import require_network
from radiant_app.network.store import open_store
from radiant_app.plain_text import plain_text
from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json, write_json

if TYPE_CHECKING:
    from radiant_app.events import Event
    from radiant_app.executors.protocol import NodeTask

CONSENT_NAME = "consent.json"


def init(folder: Path, listening: Listening | None) -> Home:
    """Make a node, or change where it is joined."""
    require_network()
    return make_home(folder, listening)


def invite(folder: Path, name: str, out: Path, identity: Identity = "pinned") -> Invitation:
    """Write a join file for the node with this name; it counts once, and in place of earlier
    ones."""
    home = open_home(folder)
    invitation = new_invitation(home, name, identity)
    # The folder first: what is written into the store takes an earlier invitation back.
    with folder_made_for(out):
        with open_store(home.folder) as store:
            store.invite(invitation.node, invitation.token)
        write_private(out, invitation_text(invitation).encode())
    return invitation


def revoke(folder: Path, name: str) -> str:
    """Refuse a node at its next request; returns its id."""
    home = open_home(folder)
    node = f"{'edges' if home.node == 'cloud' else 'devices'}/{name}"
    with open_store(home.folder) as store:
        if not store.revoke(node):
            raise BadInput(f"{node} was never invited here: radiant node status lists who was.")
    return node


def join(folder: Path, file: Path) -> Invitation:
    """Follow a join file: the node registers itself when it first reaches the one above."""
    require_network()
    if not (folder / "node.json").is_file():
        make_home(folder, None)
    return accept_invitation(open_home(folder), file)


@dataclass(kw_only=True)
class Running:
    """A node that works until it is ended."""

    say: Callable[[str], None] = print
    ended: threading.Event | None = None
    command: Callable[[NodeTask], list[str]] | None = None
    """How worker processes are started; None: as everywhere."""
    poll_s: float | None = None

    def tell(self, text: str) -> None:
        """Say a line in which other machines may be quoted."""
        self.say(plain_text(text))

    def serve(self, folder: Path, *, offline: bool = False) -> None:
        """Work as an edge: fold devices, join their models; `offline`: only on the task that was
        unpacked, without a connection to the node above. BadInput where the node is refused."""
        require_network()
        from radiant_app.executors.local import worker_command
        from radiant_app.network.edge import EdgePerformer
        from radiant_app.network.errands import Errands
        from radiant_app.network.hub import open_hub

        home = open_home(folder)
        if not home.node.startswith("edges/"):
            raise BadInput(f"{folder} is {home.node}: an edge serves, a device works, and at the cloud it is the run that serves.")
        with home.lock(), open_hub(home, self.poll_s) as hub:
            self.tell(f"{home.node} listens at port {hub.port} and {self._source(home, offline)}; Ctrl-C ends it.")
            performer = EdgePerformer(hub=hub, command=self.command or worker_command, listen=self._show)
            Errands(home=home, line=self._way(home, offline), performer=performer, say=self.tell).run()

    def work(self, folder: Path, photographs: Path, poses: Path | None, agree: Callable[[str], bool], *, offline: bool = False) -> None:
        """Work as a device, once its owner agreed to what leaves it; `offline` as for `serve`.
        BadInput where the node is refused, or its owner does not agree."""
        require_network()
        from radiant_app.executors.local import worker_command
        from radiant_app.network.device import DevicePerformer
        from radiant_app.network.errands import Errands

        home = open_home(folder)
        if not home.node.startswith("devices/"):
            raise BadInput(f"{folder} is {home.node}: a device works, an edge serves.")
        if not photographs.is_dir():
            raise BadInput(f"{photographs} is no folder: give that of this device's photographs.")
        _require_consent(home, agree)
        with home.lock():
            self.tell(f"{home.node} {self._source(home, offline)}; Ctrl-C ends it.")
            performer = DevicePerformer(home=home, photographs=photographs, poses=poses, command=self.command or worker_command)
            Errands(home=home, line=self._way(home, offline), performer=performer, say=self.tell).run()

    def _source(self, home: Home, offline: bool) -> str:
        return "works on what was unpacked" if offline else f"asks {home.upper.upper} for work"

    def _way(self, home: Home, offline: bool) -> Any:
        from radiant_app.network.carrying import CarriedWay
        from radiant_app.network.line import Line

        way = CarriedWay if offline else Line
        return way(home=home, ended=self.ended or threading.Event(), say=self.tell)

    def _show(self, event: Event) -> None:
        from radiant_app.events import StageDone, StageStarted, Warned

        if isinstance(event, StageStarted):
            self.tell(f"{event.stage}: began.")
        elif isinstance(event, StageDone):
            self.tell(f"{event.stage}: done after {event.seconds:.0f} s.")
        elif isinstance(event, Warned):
            self.tell(f"{event.stage}: {event.message}")


def consent_text(home: Home) -> str:
    """What a device's owner agrees to."""
    from radiant_app.network.device import LEAVES, STAYS

    upper = home.upper
    way = (
        "TLS to that machine's own key"
        if upper.identity == "pinned"
        else "TLS to whoever answers there: a proxy on the way can read what is sent, and change nothing"
    )
    leaves = "\n".join(f"  - {line};" for line in LEAVES)
    return f"{home.node} will send to {upper.upper} at {upper.url} ({way}):\n{leaves}\nThese never leave: {STAYS}."


def _require_consent(home: Home, agree: Callable[[str], bool]) -> None:
    """Ask once for each node above; BadInput where the answer is no."""
    path, upper = home.folder / CONSENT_NAME, home.upper
    consent = {"upper": upper.upper, "url": upper.url, "certificate": upper.certificate, "text": consent_text(home)}
    if path.is_file() and read_json(path) == consent:
        return
    if not agree(consent_text(home)):
        raise BadInput("nothing was sent: start it again to be asked again, or with --yes to agree.")
    write_json(path, consent)


def status(folder: Path) -> dict[str, Any]:
    """What a node knows of those that join it, and of itself."""
    home = open_home(folder)
    record: dict[str, Any] = {"node": home.node, "nodes": []}
    if home.node != "cloud":
        record["upper"] = {"node": home.upper.upper, "url": home.upper.url, "joined": (home.folder / "joined.json").is_file()}
    scenes = sorted(home.folder.glob("runs/*/devices/*/score/inbox/scene.ply"), key=lambda path: path.stat().st_mtime)
    if scenes:
        record["scene"] = str(scenes[-1])
    record["nodes"] = [_record_of(row) for row in read_rows(home.folder)]
    return record


def _record_of(row: NodeRow) -> dict[str, Any]:
    record: dict[str, Any] = {"node": row.node, "state": row.state, "silent_s": row.silent_s, "doing": row.doing, "software": row.software}
    if (task := row.task) is not None:
        record["task"] = {"stage": task.stage, "state": task.state, "tries": task.tries, "reason": task.reason}
        if row.num_bytes is not None:
            record["task"] |= {"arrived_bytes": row.arrived_bytes, "bytes": row.num_bytes}
    return {**record, "text": row.text}


def status_lines(record: dict[str, Any]) -> list[str]:
    """The status for people."""
    lines = [f"this machine is {record['node']}"]
    if "upper" in record:
        joined = "joined" if record["upper"]["joined"] else "will join when it answers"
        lines.append(f"above it: {record['upper']['node']} at {record['upper']['url']}, {joined}")
    if "scene" in record:
        lines.append(f"the newest finished scene: {record['scene']}")
    return [plain_text(line) for line in (*lines, *(row["text"] for row in record["nodes"]))]
