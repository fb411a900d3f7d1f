"""A web server for the tests of downloads: real sockets, ranges and entity tags, and connections that it cuts."""

from __future__ import annotations

import contextlib
import hashlib
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote


@dataclass
class Web:
    """What the server has and does.

    Attributes:
        files: contents by path, each with / before it.
        cuts: numbers of bytes after which the next answers are cut off, one for each answer.
        statuses: codes that the next answers have instead of what was asked for.
        redirects: addresses by path.
        ranges: whether a part may be asked for.
        tags: whether a state of a file has a name.
        asked: path, range and condition of each request.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    cuts: list[int] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    redirects: dict[str, str] = field(default_factory=dict)
    ranges: bool = True
    tags: bool = True
    asked: list[tuple[str, str | None, str | None]] = field(default_factory=list)
    url: str = ""


@contextlib.contextmanager
def serving_files(**files: bytes) -> Iterator[Web]:
    """Serve files on a port that the system chooses."""
    web = Web({f"/{name}": content for name, content in files.items()})

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            _answer(web, self)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base class names it so
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        web.url = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield web
        finally:
            server.shutdown()
            thread.join()


def _answer(web: Web, request: BaseHTTPRequestHandler) -> None:
    wanted, condition = request.headers.get("Range"), request.headers.get("If-Range")
    web.asked.append((request.path, wanted, condition))
    if web.statuses:
        _head(request, web.statuses.pop(0), {"Content-Length": "0"})
        return
    if request.path in web.redirects:
        _head(request, 302, {"Location": web.redirects[request.path], "Content-Length": "0"})
        return
    content = web.files.get(unquote(request.path))
    if content is None:
        _head(request, 404, {"Content-Length": "0"})
        return
    tag = f'"{hashlib.sha256(content).hexdigest()[:16]}"'
    headers = {"ETag": tag} if web.tags else {}
    start = 0
    if web.ranges and wanted and condition in (None, tag):
        start = int(wanted.removeprefix("bytes=").removesuffix("-"))
        if start >= len(content):
            _head(request, 416, {"Content-Range": f"bytes */{len(content)}", "Content-Length": "0"})
            return
        headers["Content-Range"] = f"bytes {start}-{len(content) - 1}/{len(content)}"
    _head(request, 206 if "Content-Range" in headers else 200, {**headers, "Content-Length": str(len(content) - start)})
    if not web.cuts:
        request.wfile.write(content[start:])
        return
    request.wfile.write(content[start : start + web.cuts.pop(0)])
    request.wfile.flush()
    request.close_connection = True
    request.connection.shutdown(socket.SHUT_RDWR)


def _head(request: BaseHTTPRequestHandler, status: int, headers: dict[str, str]) -> None:
    request.send_response(status)
    for key, value in headers.items():
        request.send_header(key, value)
    request.end_headers()
