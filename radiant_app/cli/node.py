"""`radiant node …`: this machine as one of several that meet over a network; heavy libraries are
imported inside, as in `cli.app`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from radiant_app.cli.help import Command, Commands
from radiant_app.cli.option_types import AsJson

node = typer.Typer(
    cls=Commands,
    help="Make this machine the cloud, an edge or a device of a run over a network (docs/network.md).",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    no_args_is_help=True,
)
HomeOption = Annotated[Path, typer.Option("--home", help="Folder of this machine's node.")]


@node.command(cls=Command)
def init(
    home: HomeOption = Path("radiant_node"),
    url: Annotated[
        str | None, typer.Option(help="https://HOST:PORT at which the nodes below reach this machine; a device has none.")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen at.")] = "0.0.0.0",  # noqa: S104
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port to listen at; by default that of --url.")] = None,
    plain: Annotated[bool, typer.Option("--plain", help="No TLS: a reverse proxy on this machine provides it.")] = False,
) -> None:
    """Create the node with its key, or change its address.

    radiant node init --url https://cloud.example:7443
    """
    from urllib.parse import urlsplit

    from radiant_app.commands.network import node as commands
    from radiant_app.network.home import Listening

    listening = None
    if url is not None:
        listening = Listening(url=url, host=host, port=port if port is not None else urlsplit(url).port or 443, plain=plain)
    node_home = commands.init(home, listening)
    node_text = "a node that is the cloud, unless it joins another one" if node_home.node == "cloud" else node_home.node
    typer.echo(f"{node_home.folder} is {node_text}.")


@node.command(cls=Command)
def invite(
    name: Annotated[str, typer.Argument(help="Id in the system file: of an edge at the cloud, of a device at its edge.")],
    home: HomeOption = Path("radiant_node"),
    out: Annotated[Path | None, typer.Option("--out", help="Join file; by default NAME.join.")] = None,
    identity: Annotated[
        Literal["pinned", "signed"],
        typer.Option(help="pinned: TLS to this node's key only; signed: behind a proxy that reads all traffic and changes nothing."),
    ] = "pinned",
) -> None:
    """Write a join file for one machine; it works once. Give it to nobody else.

    radiant node invite north --out north.join
    """
    from radiant_app.commands.network import node as commands

    path = out or Path(f"{name}.join")
    invitation = commands.invite(home, name, path, identity)
    typer.echo(f"{path} lets one machine join as {invitation.node}: take it there, then `radiant node join {path.name}`.")


@node.command(cls=Command)
def join(
    file: Annotated[Path, typer.Argument(help="Join file from the machine above.")],
    home: HomeOption = Path("radiant_node"),
) -> None:
    """Join the network by a join file.

    radiant node join north.join
    """
    from radiant_app.commands.network import node as commands

    invitation = commands.join(home, file)
    following = "radiant node work --photos FOLDER" if invitation.node.startswith("devices/") else "radiant node serve"
    typer.echo(f"{home} is {invitation.node} of {invitation.upper} at {invitation.url}; next: {following}")


OfflineOption = Annotated[bool, typer.Option("--offline", help="Work on the unpacked task only, and stop with its result.")]


@node.command(cls=Command)
def serve(home: HomeOption = Path("radiant_node"), offline: OfflineOption = False) -> None:
    """Work as an edge until Ctrl-C.

    radiant node serve
    """
    from radiant_app.commands.network import node as commands

    commands.Running(say=_say).serve(home, offline=offline)


@node.command(cls=Command)
def work(
    photos: Annotated[Path, typer.Option("--photos", help="Folder of this device's photographs, which stay there.")],
    home: HomeOption = Path("radiant_node"),
    poses: Annotated[Path | None, typer.Option(help="Their COLMAP model or alignment, for a run with --frames known.")] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Agree to what leaves this machine, without a question.")] = False,
    offline: OfflineOption = False,
) -> None:
    """Work as a device until Ctrl-C, over outbound connections only.

    radiant node work --photos PHOTOS
    """
    from radiant_app.commands.network import node as commands

    def agree(text: str) -> bool:
        typer.echo(text, err=True)
        return yes or typer.confirm("Agreed?", err=True)

    commands.Running(say=_say).work(home, photos, poses, agree, offline=offline)


@node.command(cls=Command)
def pack(
    name: Annotated[str | None, typer.Argument(help="Node below whose task is packed; without it, the result for the node above.")] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder to write, such as one on a USB disk.")] = Path("pack"),
    home: HomeOption = Path("radiant_node"),
) -> None:
    """Write a task or a result into a folder to carry; it is signed, not encrypted.

    radiant node pack north-1 --out /media/usb/pack
    """
    from radiant_app.commands.network import packs as node_packs

    typer.echo(f"{out} holds {node_packs.pack(home, name, out)} for `radiant node unpack {out.name}` there.")


@node.command(cls=Command)
def unpack(
    folder: Annotated[Path, typer.Argument(help="Folder that `radiant node pack` wrote.")],
    home: HomeOption = Path("radiant_node"),
) -> None:
    """Verify a carried folder, and take what it holds.

    radiant node unpack /media/usb/pack
    """
    from radiant_app.commands.network import packs as node_packs

    for message in node_packs.unpack(home, folder):
        typer.echo(message)


@node.command(cls=Command)
def status(home: HomeOption = Path("radiant_node"), as_json: AsJson = False) -> None:
    """List who has joined, who is silent since when, and what has arrived.

    radiant node status
    """
    from radiant_app.commands.network import node as commands

    record = commands.status(home)
    typer.echo(json.dumps(record) if as_json else "\n".join(commands.status_lines(record)))


@node.command(cls=Command)
def revoke(name: Annotated[str, typer.Argument(help="Id of the node.")], home: HomeOption = Path("radiant_node")) -> None:
    """Refuse a node from its next request on.

    radiant node revoke north-1
    """
    from radiant_app.commands.network import node as commands

    typer.echo(f"{commands.revoke(home, name)} is refused from now on; `radiant node invite {name}` lets it in again.")


def _say(text: str) -> None:
    typer.echo(text, err=True)
