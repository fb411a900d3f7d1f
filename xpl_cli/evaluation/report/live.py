"""The page of a run that grows, on this machine's own address only."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import unquote, urlsplit

from xpl_cli.basics import files
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.report import curves, media, page
from xpl_cli.evaluation.statistics.summary import summarise

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from xpl_cli.evaluation.records.records import Run

HOST = "127.0.0.1"
RENEW_SECONDS = 2.0
_POLL_SECONDS = 0.05
_NAMES = (HOST, "localhost")
_HTTP = 80
_REST = 4
"""A page is made again only after as many times as long as it took to make."""
_CURVES = re.compile(r"/curves/([0-9]{1,9})\.json")
_SILENCE_S = 20.0
"""How long a connection may say nothing: every one has a thread."""


class Growing:
    """A run and its page, made again when its record has grown. May be used from several threads.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = Lock()
        self._seen = self._stamp()
        self._run, self._page = self._make()
        self._rest_until = 0.0

    def page(self) -> bytes:
        """Return the page as it is now, or was a moment ago."""
        with self._lock:
            seen = self._stamp()
            begun = time.monotonic()
            if seen != self._seen and begun >= self._rest_until:
                self._run, self._page = self._make()
                self._seen = seen
                ended = time.monotonic()
                self._rest_until = ended + _REST * (ended - begun)
            return self._page

    def _make(self) -> tuple[Run, bytes]:
        run = records.read(self._folder)
        shown = media.shown(run, budget=0, link="")
        return run, page.render(run, summarise(run), shown, renew_seconds=RENEW_SECONDS).encode(errors="replace")

    def run(self) -> Run:
        """Return the run as the page shows it."""
        with self._lock:
            return self._run

    def _stamp(self) -> tuple[int, int]:
        try:
            found = (self._folder / records.FILE).stat()
        except OSError:
            return 0, 0  # reading tells what is wrong
        return found.st_mtime_ns, found.st_size


def server(folder: Path, port: int = 0) -> ThreadingHTTPServer:
    """Return a server of the page of a run, which listens on the loopback address only.

    Args:
        folder: of the run.
        port: 0 lets the system choose.

    Raises:
        NotFoundError: if there is no run.
        UserError: if the port is taken.
    """
    growing = Growing(folder)

    class Handler(_Handler):
        shown = growing

    try:
        return _Server((HOST, port), Handler)
    except OSError as error:
        raise UserError(f"{HOST}:{port} cannot be listened on: {error.strerror}", code=ExitCode.NOT_RUN) from None


@contextlib.contextmanager
def serving(folder: Path, port: int = 0) -> Iterator[str]:
    """Serve the page of a run beside other work, and yield its address.

    Raises:
        NotFoundError: if there is no run.
        UserError: if the port is taken.
    """
    with server(folder, port) as running:
        Thread(target=running.serve_forever, args=(_POLL_SECONDS,), daemon=True).start()
        try:
            yield address(running)
        finally:
            running.shutdown()


def address(running: ThreadingHTTPServer) -> str:
    """Return where a server's page is."""
    return f"http://{HOST}:{running.server_address[1]}/"


class _Server(ThreadingHTTPServer):
    """A server that says nothing of clients who go away."""

    daemon_threads = True

    def handle_error(self, *_: Any) -> None:
        """Say nothing: the terminal belongs to the evaluation."""


class _Handler(BaseHTTPRequestHandler):
    """Answers for the page, the curves of an episode, and the films and traces that the record names."""

    shown: Growing
    protocol_version = "HTTP/1.1"

    timeout = _SILENCE_S

    def do_GET(self) -> None:
        """Answer a request."""
        # Another site's page, or a name of it that was made to lead here, must not be able to read the run.
        if not self._is_ours():
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            return
        try:
            path = unquote(urlsplit(self.path).path)
            if path == "/":
                self._send(self.shown.page(), "text/html; charset=utf-8")
            elif match := _CURVES.fullmatch(path):
                self._send_curves(int(match[1]))
            elif path.startswith("/curves/"):
                self.send_error(HTTPStatus.BAD_REQUEST, "expected the number of an episode")
            else:
                self._send_file(path.removeprefix("/"))
        except ValueError:
            self.send_error(HTTPStatus.BAD_REQUEST)
        except (UserError, OSError) as error:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, explain=str(error))

    def _is_ours(self) -> bool:
        """Tell whether a request names this server, once and as itself, and no other site is behind it."""
        port = cast("tuple[str, int]", self.server.server_address)[1]
        ours = {f"{name}{ending}" for name in _NAMES for ending in (f":{port}", *([""] if port == _HTTP else []))}
        origins = self.headers.get_all("Origin", [])
        return (
            [host in ours for host in self.headers.get_all("Host", [])] == [True]
            and not urlsplit(self.path[:8]).scheme
            and all(origin.removeprefix("http://") in ours for origin in origins)
        )

    def _send_curves(self, index: int) -> None:
        run = self.shown.run()
        episode = run.finals.get(index)
        if episode is None or episode.trace is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        drawn = curves.read(media.locate(run.folder, episode.trace, media.TRACE))
        self._send(json.dumps(drawn).encode(), "application/json")

    def _send_file(self, name: str) -> None:
        """Send a file that the record names, and no other."""
        run = self.shown.run()
        for episode in run.finals.values():
            for kind, file in ((media.FILM, episode.film), (media.TRACE, episode.trace)):
                if file is not None and file.path == name:
                    path = media.locate(run.folder, file, kind)
                    self._send(
                        files.content(path), media.MEDIA_TYPES.get(path.suffix.lower(), "application/octet-stream")
                    )
                    return
        self.send_error(HTTPStatus.NOT_FOUND)

    def _send(self, content: bytes, kind: str) -> None:
        tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
        same = self.headers.get("If-None-Match") == tag
        self.send_response(HTTPStatus.NOT_MODIFIED if same else HTTPStatus.OK)
        self.send_header("ETag", tag)
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        if not same:
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if not same:
            self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Say nothing: the terminal belongs to the evaluation."""
