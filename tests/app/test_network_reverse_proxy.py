"""Behind a reverse proxy that has the TLS and reads all that passes (`--identity signed`): it works, and the proxy can change nothing."""

from __future__ import annotations

import datetime
import http.client
import ipaddress
import re
import shutil
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from radiant_app.commands.network import node as commands
from radiant_app.network import line as lines
from radiant_app.network.home import Listening, make_home, open_home
from radiant_app.network.hub import open_hub
from radiant_app.network.line import Line
from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import MODEL_NAME
from tests.app.network_nodes import free_port, listening
from tests.app.network_transfer import deliver, offer, write_model

Spoil = Callable[[int, str, bytes, dict[str, str]], tuple[bytes, dict[str, str]]]


def as_it_is(number: int, way: str, body: bytes, headers: dict[str, str]) -> tuple[bytes, dict[str, str]]:
    return body, headers


def certificate_of(folder: Path) -> Path:
    """A certificate for 127.0.0.1 that the system is told to trust; with its key in one file."""
    key = ec.generate_private_key(ec.SECP256R1())
    name, now = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "proxy")]), datetime.datetime.now()
    made = x509.CertificateBuilder(subject_name=name, issuer_name=name, public_key=key.public_key(), serial_number=1)
    made = made.not_valid_before(now - datetime.timedelta(2)).not_valid_after(now + datetime.timedelta(2))
    names = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    signed = made.add_extension(names, critical=False).sign(key, hashes.SHA256())
    path = folder / "proxy.pem"
    private = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    path.write_bytes(private + signed.public_bytes(serialization.Encoding.PEM))
    return path


@contextmanager
def reverse_proxy(folder: Path, target: int, spoil: Spoil, seen: list[bytes]) -> Iterator[int]:
    """An HTTP proxy with TLS that writes headers anew; `spoil` changes what passes."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle_one(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", "0")))
            seen.append(body)
            number = len(seen)
            body, headers = spoil(number, "up", body, {name: value for name, value in self.headers.items() if name.lower() != "connection"})
            headers |= {"Host": "inside", "X-Forwarded-For": "1.2.3.4", "Via": "1.1 proxy", "Content-Length": str(len(body))}
            inside = http.client.HTTPConnection("127.0.0.1", target, timeout=10)
            inside.request(self.command, self.path, body, headers)
            reply = inside.getresponse()
            found = reply.read()
            seen.append(found)
            found, headers = spoil(number, "down", found, dict(reply.getheaders()))
            inside.close()
            self.send_response(reply.status)
            for name, value in headers.items():
                if name.lower() not in ("content-length", "connection"):
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(found)))
            self.end_headers()
            self.wfile.write(b"" if self.command == "HEAD" else found)

        do_GET = do_HEAD = do_POST = do_PATCH = handle_one

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate_of(folder))
    server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def nginx(folder: Path, target: int) -> Iterator[int]:
    """nginx with the server of docs/network.md, whose places are filled in."""
    page = (Path(__file__).parents[2] / "docs" / "network.md").read_text()
    server = page[page.index("    server {\n") :].partition("\n    }\n")[0] + "\n    }\n"
    certificate, outside = certificate_of(folder), free_port()
    for said, here in (("443 ssl", f"127.0.0.1:{outside} ssl"), ("server_name HOST", "server_name 127.0.0.1"), (":8443", f":{target}")):
        assert said in server
        server = server.replace(said, here)
    server = re.sub(r"/etc/ssl/HOST\.(pem|key)", str(certificate), server)
    places = "".join(f"{name}_temp_path {folder / name};" for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
    (folder / "nginx.conf").write_text(
        f"daemon off; master_process off; pid {folder / 'nginx.pid'}; events {{}} http {{ access_log off; {places}\n{server} }}"
    )
    running = subprocess.Popen(["nginx", "-p", folder, "-c", folder / "nginx.conf", "-e", folder / "nginx.log"])
    try:
        _wait_for(outside, folder / "nginx.log")
        yield outside
    finally:
        running.terminate()
        running.wait()


def _wait_for(port: int, log: Path) -> None:
    until_s = time.monotonic() + 10
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return
        except OSError:
            assert time.monotonic() < until_s, log.read_text()
            time.sleep(0.02)


class Road:
    """A device, a proxy, an edge that listens without TLS."""

    def __init__(self, folder: Path, spoil: Spoil) -> None:
        self.folder, self.spoil, self.seen = folder, spoil, list[bytes]()

    def proxy(self, target: int) -> AbstractContextManager[int]:
        return reverse_proxy(self.folder, target, self.spoil, self.seen)

    @contextmanager
    def open(self) -> Iterator[tuple[Line, Callable[[], bytes]]]:
        port = free_port()
        with self.proxy(port) as outside:
            make_home(self.folder / "cloud", listening())
            commands.init(self.folder / "north", Listening(url=f"https://127.0.0.1:{outside}", host="127.0.0.1", port=port, plain=True))
            commands.invite(self.folder / "cloud", "north", self.folder / "north.join")
            commands.join(self.folder / "north", self.folder / "north.join")
            commands.invite(self.folder / "north", "d", self.folder / "d.join", "signed")
            commands.join(self.folder / "d", self.folder / "d.join")
            write_model(self.folder / "model", 3 << 20, 1)
            with open_hub(open_home(self.folder / "north"), 0.1) as hub:
                digest = offer(hub, self.folder, "d")
                line = Line(home=open_home(self.folder / "d"))

                def received() -> bytes:
                    hub.install(digest)
                    return (self.folder / "asked" / "d" / MODEL_NAME).read_bytes()

                try:
                    yield line, received
                finally:
                    line.close()


@pytest.fixture(autouse=True)
def trust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "proxy.pem"))
    monkeypatch.setattr(lines, "FIRST_WAIT_S", 0.01)


def test_a_model_arrives_through_a_proxy_that_reads_it(tmp_path: Path) -> None:
    road = Road(tmp_path, as_it_is)
    with road.open() as (line, received):
        line.join()
        deliver(line, tmp_path / "model", tmp_path / "task")
        model = (tmp_path / "model" / MODEL_NAME).read_bytes()
        assert received() == model and line.num_resumed == 0
    assert any(model[:1000] in body for body in road.seen), "with --identity signed a proxy reads what passes: docs/network.md says so"
    assert "a proxy on the way can read what is sent, and change nothing" in commands.consent_text(open_home(tmp_path / "d"))


class NginxRoad(Road):
    def proxy(self, target: int) -> AbstractContextManager[int]:
        return nginx(self.folder, target)


@pytest.mark.skipif(shutil.which("nginx") is None, reason="needs nginx")
def test_a_model_arrives_through_nginx_as_the_page_sets_it_up(tmp_path: Path) -> None:
    with NginxRoad(tmp_path, as_it_is).open() as (line, received):
        line.join()
        deliver(line, tmp_path / "model", tmp_path / "task")
        assert received() == (tmp_path / "model" / MODEL_NAME).read_bytes() and line.num_resumed == 0


def spoil_some(number: int, way: str, body: bytes, headers: dict[str, str]) -> tuple[bytes, dict[str, str]]:
    """Each third exchange: another body up, another body down, or another offset."""
    if number % 6 == 1 and way == "up" and body:
        return body[:-1] + bytes([body[-1] ^ 1]), headers
    if number % 6 == 3 and way == "down":
        return body + b" ", headers
    if number % 6 == 5 and way == "down":
        return body, {name: "7" if name.lower() == "upload-offset" else value for name, value in headers.items()}
    return body, headers


def test_what_a_proxy_changes_is_seen_and_asked_again(tmp_path: Path) -> None:
    road = Road(tmp_path, spoil_some)
    with road.open() as (line, received):
        line.join()
        deliver(line, tmp_path / "model", tmp_path / "task")
        assert received() == (tmp_path / "model" / MODEL_NAME).read_bytes() and line.num_resumed > 2


def test_a_proxy_whose_own_pages_come_is_no_node(tmp_path: Path) -> None:
    """An answer of somebody else is as none: it is asked again until the node itself answers, and the owner told."""
    said: list[str] = []
    road = Road(tmp_path, lambda number, way, body, headers: (b"<html>502</html>", {}) if way == "down" else (body, headers))
    with road.open() as (line, _):
        line.say = said.append
        joining = threading.Thread(target=_join_in_vain, args=(line,), daemon=True)
        joining.start()
        while not said:
            joining.join(0.05)
        line.ended.set()
        joining.join(10)
    assert "that is not signed by it" in said[0]


def _join_in_vain(line: Line) -> None:
    with pytest.raises((lines.Withdrawn, BadInput)):
        line.join()


def test_a_pinned_node_does_not_talk_to_a_proxy(tmp_path: Path) -> None:
    road = Road(tmp_path, as_it_is)
    with road.open() as (line, _):
        line.upper = type(line.upper)(**{**vars(line.upper), "identity": "pinned"})
        assert line.ask_once("POST", "/poll", b"{}") is None
        assert "CERTIFICATE_VERIFY_FAILED" in line._trouble and road.seen == []
