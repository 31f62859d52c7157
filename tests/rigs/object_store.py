"""Object store of tests: moto's S3 server behind a proxy that counts bytes and makes faults."""

from __future__ import annotations

import http.client
import importlib.util
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

_OWN = Path(__file__).parents[2] / ".venv-moto" / ("Scripts" if os.name == "nt" else "bin") / "python"


def moto_python() -> str | None:
    """Interpreter that has moto, best in an environment of its own: beside its boto3, rasterio starts 80 ms later."""
    named = os.environ.get("GEOMOSAIC_MOTO_PYTHON") or (str(_OWN) if _OWN.exists() else None)
    return named or (sys.executable if importlib.util.find_spec("moto") else None)


NO_MOTO = "needs moto: python -m venv .venv-moto && .venv-moto/bin/pip install 'moto[server]>=5'"


@dataclass
class Seen:
    """Request that went through the proxy."""

    method: str
    path: str
    range: str
    status: int
    sent: int
    received: int


@dataclass
class Proxy:
    """Proxy in front of a store.

    Attributes
    ----------
    seen : list of Seen
    storm : int
        So many further requests are answered by 503.
    cut : int
        So many further answers to GET end in the middle of their contents.
    refuse : str
        Method and beginning of a path (a regular expression) that always get 503.
    """

    target: str
    seen: list[Seen] = field(default_factory=list)
    storm: int = 0
    cut: int = 0
    refuse: str = ""
    endpoint: str = ""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def read(self, suffix: str = "") -> int:
        """Bytes of contents that objects of such names sent."""
        return sum(one.sent for one in self.seen if one.method == "GET" and urlsplit(one.path).path.endswith(suffix))


def _handler(proxy: Proxy) -> type[BaseHTTPRequestHandler]:
    host = urlsplit(proxy.target).netloc

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle_any(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            with proxy.lock:
                refused = bool(proxy.refuse and re.match(proxy.refuse, f"{self.command} {self.path}"))
                storm = proxy.storm > 0 and not refused
                proxy.storm -= storm
            if storm or refused:
                self._answer(503, {}, b"<Error><Code>SlowDown</Code></Error>", body)
                return
            connection = http.client.HTTPConnection(host, timeout=60)
            # The signature covers the name of the host that the client asked.
            connection.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
            for name, value in self.headers.items():
                connection.putheader(name, value)
            connection.endheaders(body or None)
            answer = connection.getresponse()
            content = answer.read()
            connection.close()
            cut = False
            if self.command == "GET" and answer.status in (200, 206) and "list-type" not in self.path:
                with proxy.lock:
                    cut = proxy.cut > 0
                    proxy.cut -= cut
            self._answer(answer.status, dict(answer.getheaders()), content, body, cut=cut)

        do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = handle_any

        def _answer(self, status: int, headers: dict[str, str], content: bytes, body: bytes, cut: bool = False) -> None:
            self.send_response(status)
            length = headers.get("Content-Length", str(len(content)))
            for name, value in headers.items():
                if name.lower() not in ("content-length", "connection", "transfer-encoding", "server", "date"):
                    self.send_header(name, value)
            self.send_header("Content-Length", length)
            self.end_headers()
            sent = content[: len(content) // 2] if cut else content
            with proxy.lock:
                seen = self.headers.get("Range", "")
                proxy.seen.append(Seen(self.command, self.path, seen, status, len(sent), len(body)))
            if self.command != "HEAD":
                self.wfile.write(sent)
            if cut:
                self.wfile.flush()
                self.close_connection = True

        def log_message(self, *_: object) -> None:
            pass

    return Handler


@contextmanager
def proxied(target: str) -> Iterator[Proxy]:
    """Proxy in front of a server of this machine."""
    proxy = Proxy(target)
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(proxy))
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    proxy.endpoint = f"http://127.0.0.1:{server.server_address[1]}"
    try:
        yield proxy
    finally:
        server.shutdown()
        server.server_close()


@dataclass(frozen=True)
class Server:
    """S3 server: its own address, a key that may do all, and key and secret of one who may only read."""

    endpoint: str
    key: str
    secret: str
    reader: tuple[str, str]
    process: Any = None

    def uploads(self) -> int:
        """Number of uploads that were begun and neither completed nor aborted."""
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return int(self.process.stdout.readline())


@contextmanager
def moto_server() -> Iterator[Server]:
    """Moto's S3 server with the bucket `tests`, where keys are checked."""
    python = moto_python()
    assert python is not None
    process = subprocess.Popen(
        [python, str(Path(__file__).with_name("moto_server.py"))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
        yield Server(told["endpoint"], *told["keys"]["all"], tuple(told["keys"]["reader"]), process)
    finally:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()


@contextmanager
def web_server(folder: Path, query: str, user: str) -> Iterator[str]:
    """Web server of a folder, which answers to a query or a user (`name:password`) alone; gives `http://host:port`."""
    import base64

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            parts = urlsplit(self.path)
            known = f"Basic {base64.b64encode(user.encode()).decode()}"
            file = folder / parts.path.lstrip("/")
            status, content, headers = 200, b"", {}
            if parts.query != query and self.headers.get("Authorization") != known:
                status = 403
            elif not file.is_file():
                status = 404
            else:
                content = file.read_bytes()
                headers = {"Last-Modified": "Sat, 01 Jan 2022 00:00:00 GMT"}
                if found := re.match(r"bytes=(\d+)-(\d+)", self.headers.get("Range") or ""):
                    start, stop = int(found[1]), min(int(found[2]) + 1, len(content))
                    headers["Content-Range"] = f"bytes {start}-{stop - 1}/{len(content)}"
                    status, content = 206, content[start:stop]
            self.send_response(status)
            for name, value in {**headers, "Content-Length": str(len(content))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


# Account and key of Azure's emulators, which are the same everywhere.
AZURITE_ACCOUNT = "devstoreaccount1"
AZURITE_KEY = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="
NO_AZURITE = "needs azurite: npm install --prefix .azurite azurite"


def azurite() -> str | None:
    """Program of the emulator's blob service."""
    own = Path(__file__).parents[2] / ".azurite" / "node_modules" / ".bin" / "azurite-blob"
    return os.environ.get("GEOMOSAIC_AZURITE") or (str(own) if own.exists() else shutil.which("azurite-blob"))


@contextmanager
def azurite_server(folder: Path) -> Iterator[str]:
    """Blob service of Azure's emulator with the container `tests`; gives its connection string."""
    import base64
    import hashlib
    import hmac
    from email.utils import formatdate

    program = azurite()
    assert program is not None
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen(
        [program, "--blobPort", str(port), "--location", str(folder), "--silent", "--skipApiVersionCheck"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        now, version = formatdate(usegmt=True), "2021-08-06"
        resource = f"/{AZURITE_ACCOUNT}/{AZURITE_ACCOUNT}/tests\nrestype:container"
        text = f"PUT{chr(10) * 12}x-ms-date:{now}\nx-ms-version:{version}\n{resource}"
        key = hmac.new(base64.b64decode(AZURITE_KEY), text.encode(), hashlib.sha256).digest()
        signature = f"SharedKey {AZURITE_ACCOUNT}:{base64.b64encode(key).decode()}"
        headers = {"x-ms-date": now, "x-ms-version": version, "Authorization": signature, "Content-Length": "0"}
        for _ in range(200):
            try:
                connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
                connection.request("PUT", f"/{AZURITE_ACCOUNT}/tests?restype=container", headers=headers)
                answer = connection.getresponse()
                break
            except OSError:
                time.sleep(0.1)
        assert answer.status == 201, answer.read()
        connection.close()
        yield (
            f"DefaultEndpointsProtocol=http;AccountName={AZURITE_ACCOUNT};AccountKey={AZURITE_KEY};"
            f"BlobEndpoint=http://127.0.0.1:{port}/{AZURITE_ACCOUNT};"
        )
    finally:
        process.kill()
        process.wait()
