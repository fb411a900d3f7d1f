"""The page of a growing run, asked by whoever can reach a port of this machine: other sites, and made-up requests."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from tests.support.recordings.runs import synthetic
from xpl_cli.evaluation.report import live


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Serve the page of a run with curves, and return the port."""
    with live.serving(synthetic(tmp_path_factory.mktemp("live") / "run", episodes=2, traces=1)) as url:
        found = urlsplit(url).port
        assert found is not None
        yield found


def _status(port: int, request: bytes) -> int:
    """Send the bytes of a request, and return the status of the answer; 0 if it has none."""
    with socket.create_connection(("127.0.0.1", port), 30) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        answer = connection.makefile("rb").readline()
    return int(answer.split()[1]) if answer.startswith(b"HTTP/1") else 0


def _get(port: int, path: str, *lines: str) -> int:
    head = "\r\n".join([f"GET {path} HTTP/1.1", *(line.replace("PORT", str(port)) for line in lines), "", ""])
    return _status(port, head.encode("latin-1"))


OWN = "Host: 127.0.0.1:PORT"


@pytest.mark.parametrize(
    "lines",
    [
        (),
        ("Host:",),
        ("Host: evil.example",),
        ("Host: evil.example:PORT",),
        ("Host: 127.0.0.1.evil.example:PORT",),
        ("Host: evil@localhost:PORT",),
        ("Host: 127.0.0.1:1",),
        ("Host: [::1",),
        ("Host: [",),
        (OWN, "Host: evil.example"),
        (OWN, OWN),
        (OWN, "Origin: https://evil.example"),
        (OWN, "Origin: null"),
        (OWN, "Origin: http://127.0.0.1:1"),
    ],
)
def test_other_sites_are_told_nothing(lines: tuple[str, ...], port: int) -> None:
    """Neither under another name, nor under two, nor from a page of another origin."""
    assert _get(port, "/", *lines) == 421


def test_a_request_for_another_site_is_told_nothing(port: int) -> None:
    """As proxies are asked."""
    assert _get(port, "http://evil.example/", OWN) == 421
    assert _get(port, "/", OWN) == _get(port, "/", "Host: localhost:PORT") == 200
    assert _get(port, "/", OWN, "Origin: http://127.0.0.1:PORT") == 200


@pytest.mark.parametrize("number", ["9" * 4300, "9" * 20, "-1", "1.0", "", "x", "%00", "\u0663", "0x1", "1%0a"])
def test_what_is_no_number_is_a_bad_request(number: str, port: int) -> None:
    """Also one with more digits than Python reads."""
    path = f"/curves/{number}.json".encode().decode("latin-1")
    assert _get(port, path, OWN) == 400
    assert _get(port, "/curves/0.json", OWN) == 200
    assert _get(port, "/curves/1.json", OWN) == 404


@pytest.mark.parametrize(
    "request_line",
    [b"\r\n\r\n", b"GET\r\n\r\n", b"\0" * 100, b"GET / HTTP/9.9\r\n\r\n", b"PUT / HTTP/1.1\r\n\r\n", b"A" * 70_000],
)
def test_what_is_no_request_ends_nothing(request_line: bytes, port: int, capfd: pytest.CaptureFixture[str]) -> None:
    """The next one is answered, and nothing is written to the terminal of the run."""
    _status(port, request_line)
    assert _get(port, "/", OWN) == 200
    assert capfd.readouterr() == ("", "")
