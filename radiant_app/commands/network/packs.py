"""What `radiant node pack` and `node unpack` do: work that goes by a disk instead of a network."""

from __future__ import annotations

from pathlib import Path

from radiant_app.network.carrying import keep_task, pack_own
from radiant_app.network.errands import note_task, require_own
from radiant_app.network.home import UPPER_NAME, Home, open_home
from radiant_app.network.packs import has_list, open_pack, read_join
from radiant_app.network.receiving import open_desk
from radiant_app.network.store import STORE_NAME
from radiant_core.errors import BadInput

TIER_BELOW = {"cloud": "edges", "edges": "devices"}


def pack(home_folder: Path, name: str | None, folder: Path) -> str:
    """Write what this node has for the node below with this name, or, without one, for the node
    above; says what it was. Raises as `write_pack`."""
    home = open_home(home_folder)
    if name is None:
        return pack_own(home, folder)
    tier = TIER_BELOW.get(home.node.split("/")[0])
    if tier is None or not (home.folder / STORE_NAME).is_file():
        raise BadInput(f"nobody has joined {home.node}: without a name what it has for the node above is packed.")
    with open_desk(home) as desk:
        return f"the task of {desk.pack_task(f'{tier}/{name}', folder)},"


def unpack(home_folder: Path, folder: Path) -> list[str]:
    """Take what is in a folder, once all of it was verified; says what it was.

    Raises:
        BadInput: it is for somebody else, altered, not whole, or not awaited.
        CannotWrite: there is no room for it.
    """
    home = open_home(home_folder)
    if has_list(folder) and (message := _unpack_task(home, folder)) is not None:
        return [message]
    if not (home.folder / STORE_NAME).is_file():
        # Says why it cannot be used.
        open_pack(folder, [])
        raise BadInput(f"{folder} is nothing for {home.node}.")
    return _unpack_from_below(home, folder)


def _unpack_task(home: Home, folder: Path) -> str | None:
    """Keep a task of the node above; None where the pack is not signed by it."""
    if not (home.folder / UPPER_NAME).is_file():
        return None
    upper = home.upper
    try:
        task = open_pack(folder, [upper.key])
    except BadInput:
        return None
    require_own(home, task.envelope)
    task.check()
    replaced = keep_task(home, task)
    # From now on no older one of its stage is taken, however often its pack is found again.
    note_task(home, task.envelope)
    command = "radiant node work --photos FOLDER --offline" if home.node.startswith("devices/") else "radiant node serve --offline"
    instead = ""
    if replaced is not None:
        of_run = "" if replaced.run == task.envelope.run else " of another run"
        instead = f", in place of that of {replaced.stage}{of_run}, which is not done"
    return f"the task of {task.envelope.stage} is here{instead}; next: {command}"


def _unpack_from_below(home: Home, folder: Path) -> list[str]:
    messages = []
    with open_desk(home) as desk:
        join = read_join(folder)
        if join is not None:
            try:
                messages.append(f"{desk.take_join(*join)} has joined.")
            except BadInput:
                # With a result its older key may still be the one that counts.
                if not has_list(folder):
                    raise
        if has_list(folder) or join is None:
            messages.append(f"{desk.take_result(desk.open(folder))}.")
    return messages
