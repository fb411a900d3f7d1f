"""Who may come in: web pages, foreign names, tokens, and connections that ask for nothing."""

from __future__ import annotations

import contextlib
import json
import resource
import socket
import string
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.outside.raw import CLOSE, Raw, dial, page
from tests.support.peer import DEADLINE_S, Peer, wait_until, xpl
from xpl import Client
from xpl import _spec as spec
from xpl.client import EnvironmentMismatchError, ServerConnectionError
from xpl.wire import codec
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.serving.entry import connection_limiter
from xpl_cli.serving.entry.allowed_hosts import AllowedHosts
from xpl_cli.serving.launch import RunningServer, running_server

MODEL = """
    class Model:
        def __init__(self, config): pass
        def update_obs(self, obs): pass
        def get_action(self): return [1]
        def reset(self): pass
        def infer(self, observation): return [1]
"""
TOKEN = "a-token-of-thirty-two-characters"
EVIL = "https://evil.example"
ONCE: dict[str, Any] = {"max_connect_attempts": 1, "connect_timeout_s": DEADLINE_S}


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(MODEL)


@pytest.fixture(scope="module")
def server(subject: Path) -> Iterator[RunningServer]:
    """Serve it on loopback, as most people do; one page and one name are allowed."""
    options = ["--allow-origin", "https://lab.example:8443", "--allow-host", "gpu-7.lab", "--metrics"]
    with running_server(subject, options=options) as running:
        yield running


@pytest.fixture(scope="module")
def guarded(subject: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    secret = tmp_path_factory.mktemp("secret") / "token"
    secret.write_text(TOKEN, encoding="ascii")
    secret.chmod(0o600)
    with running_server(subject, options=["--token-file", str(secret)]) as running:
        yield running


# -- web pages and foreign names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("origin", [EVIL, "null", "https://127.0.0.1.evil.example", "", "https://lab.example", "\x80"])
def test_a_web_page_of_a_stranger_does_not_reach_the_policy(server: RunningServer, origin: str) -> None:
    """Neither by WebSocket nor by a plain page: a browser says whose page it is."""
    with contextlib.closing(Raw(server.url, f"Origin: {origin}")) as raw:
        assert raw.status == 403
    assert page(server.url, "/healthz", Origin=origin)[0] == 403
    assert page(server.url, "/metrics", Origin=origin)[0] == 403


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8000", "localhost.evil.example", "2130706433", "a@b", ""]
)
def test_a_foreign_name_for_this_machine_is_refused(server: RunningServer, host: str) -> None:
    """Whoever owns the name may have it stand for loopback (DNS rebinding)."""
    with contextlib.closing(Raw(server.url, host=host)) as raw:
        assert raw.status == 403
    assert page(server.url, "/healthz", Host=host)[0] == 403


def test_two_of_one_header_are_refused(server: RunningServer) -> None:
    """The first may be meant for us and the second for someone in between."""
    for headers in (["Origin: http://localhost", f"Origin: {EVIL}"], ["Host: evil.example"]):
        with contextlib.closing(Raw(server.url, *headers)) as raw:
            assert raw.status == 403


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:1", "127.0.0.1:8000", "[::1]:8000", "robot.localhost", "gpu-7.lab"]
)
@pytest.mark.parametrize("origin", [None, "http://localhost:3000", "http://127.0.0.1", "https://lab.example:8443"])
def test_who_belongs_here_is_let_in(server: RunningServer, host: str, origin: str | None) -> None:
    """Loopback names, names and pages that were allowed, and clients that are no browsers."""
    headers = [] if origin is None else [f"Origin: {origin}"]
    with contextlib.closing(Raw(server.url, *headers, host=host)) as raw:
        assert raw.status == 101


def test_a_client_is_told_why_it_is_refused(subject: Path, serve: Callable[..., RunningServer]) -> None:
    """With what the operator has to do; it does not try again."""
    server = serve(subject, options=["--insecure", "--host", "0.0.0.0"])  # noqa: S104
    port = server.url.rpartition(":")[2]
    with contextlib.closing(Raw(server.url, host="192.0.2.7")) as raw:  # an address is nobody's to give away
        assert raw.status == 101
    with contextlib.closing(Raw(server.url, host=f"evil.example:{port}")) as raw:
        assert raw.status == 403
    proxied = socket.getaddrinfo
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket, "getaddrinfo", lambda host, *rest, **more: proxied("127.0.0.1", *rest, **more))
        with pytest.raises(ServerConnectionError, match="--allow-host names what it goes by"):
            Client(f"ws://gpu.evil.example:{port}")


def test_a_token_lets_any_name_in_and_no_page(guarded: RunningServer) -> None:
    """A page cannot show it, whatever it calls this machine."""
    shown = f"Authorization: Bearer {TOKEN}"
    with contextlib.closing(Raw(guarded.url, shown, host="policy.cluster.local")) as raw:
        assert raw.status == 101
    with contextlib.closing(Raw(guarded.url, shown, f"Origin: {EVIL}")) as raw:
        assert raw.status == 403


@pytest.mark.parametrize("other", ["wrong", TOKEN, ""])
def test_exactly_one_token_counts(guarded: RunningServer, other: str) -> None:
    """Two headers are refused, also where the first one is right."""
    for tokens in ((TOKEN, other), (other, TOKEN)):
        with contextlib.closing(Raw(guarded.url, *(f"Authorization: Bearer {one}" for one in tokens))) as raw:
            assert raw.status == 401


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "arguments",
    [["--allow-host", "gpu:80"], ["--allow-host", ""], ["--allow-origin", "evil.example"], ["--allow-origin", "*"]],
)
def test_what_is_no_name_is_not_allowed(subject: Path, tmp_path: Path, arguments: list[str]) -> None:
    run = xpl("serve", str(subject), "--port", "0", *arguments, cwd=tmp_path)
    assert (run.returncode, run.stdout) == (ExitCode.USAGE, "")
    assert f"{arguments[0]} takes" in run.stderr


anything = st.text(st.characters(codec="latin-1"), max_size=40) | st.text(string.printable, max_size=40)


@settings(max_examples=examples(100), deadline=None)
@given(hosts=st.lists(anything, max_size=3), origins=st.lists(anything, max_size=3))
def test_no_header_ends_in_more_than_a_sentence(hosts: list[str], origins: list[str]) -> None:
    """Whatever the headers hold: a refusal is printable, and only the names that are ours pass."""
    names = AllowedHosts("localhost")
    for told in (names.host_refusal(hosts), names.origin_refusal(origins)):
        assert told is None or told.isprintable()
    if names.host_refusal(hosts) is None:
        (host,) = hosts
        assert host.lower().startswith(("localhost", "127.", "[::1]")) or ".localhost" in host.lower()


def test_a_name_is_checked_when_it_is_given() -> None:
    for given_names in ({"hosts": ["a b"]}, {"origins": ["https://"]}, {"origins": ["https://a/path"]}):
        with pytest.raises(UserError):
            AllowedHosts("localhost", **given_names)


def test_a_robot_is_served_by_a_server_that_asks_for_a_token_only(server: RunningServer, subject: Path) -> None:
    """Anybody on the machine could otherwise take its place; who starts one with a secret knows it."""
    robot = {"real_time": True}
    with pytest.raises(EnvironmentMismatchError, match="start it with --token-file"):
        Client(server.url, config=ONCE, environment=robot)
    with running_server(subject, token="a-token-of-this-test") as own:
        with pytest.raises(ServerConnectionError, match="bearer token"):
            Client(own.url, config=ONCE, environment=robot)
        with Client(own.url, config=ONCE, environment=robot, token=own.token) as client:
            assert client.infer({}) == [1]
    with Client(server.url, config=ONCE, environment={"real_time": False}) as client:
        assert client.infer({}) == [1]


# -- requests that cannot be read --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "lines",
    [
        [
            "GET / HTTP/1.1",
            "Host: localhost",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: \udcff",
        ],
        ["GET /\udcff HTTP/1.1", "Host: localhost", "X: \udc80"],
        ["GET /\x1b[31m HTTP/1.1", "Host: localhost"],
        ["POST / HTTP/1.1", "Host: localhost"],
        ["\udcff"],
        ["GET / HTTP/1.1", "Host: localhost", "a\udcff: b"],
        ["GET / HTTP/1.1"],
    ],
)
def test_a_refusal_never_raises(server: RunningServer, lines: list[str]) -> None:
    """It is an answer in plain HTTP, without a traceback in the log."""
    before = len(server.log)
    with dial(server.url) as stranger:
        stranger.sendall("\r\n".join([*lines, "", ""]).encode("utf-8", "surrogateescape"))
        assert stranger.recv(1 << 16).startswith(b"HTTP/1.1 4")
    page(server.url, "/healthz")
    assert not any("Traceback" in line or "\x1b" in line for line in list(server.log)[before:])


# -- connections that ask for nothing ----------------------------------------------------------------------------------


def still_served(server: RunningServer) -> None:
    with Client(server.url, config=ONCE) as client:
        assert client.infer({}) == [1]


def test_connections_that_ask_for_nothing_keep_nobody_out(subject: Path, serve: Callable[..., RunningServer]) -> None:
    """Not even more of them than the server has descriptors; the log has a line of it, not one for each."""
    # Starting takes some in this process, too, which may have many open.
    few = max(256, 64 + max(int(entry.name) for entry in Path("/proc/self/fd").iterdir()))
    with few_descriptors(few):
        server = serve(subject)
    with contextlib.ExitStack() as stack:
        for _ in range(few + 144):
            stack.enter_context(dial(server.url))
        still_served(server)
        assert json.loads(page(server.url, "/healthz")[1])["state"] == "ready"
        assert len(server.log) < 20, list(server.log)
        assert any("without a request" in line for line in server.log)


@contextlib.contextmanager
def few_descriptors(count: int) -> Iterator[None]:
    """Have the processes that are started in this block get only so many descriptors."""
    kept = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (count, kept[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, kept)


def test_a_server_without_descriptors_turns_away_and_goes_on(tmp_path: Path) -> None:
    """One is kept for that, so that what waits at the door does not wake the server again and again."""
    entry = connection_limiter.ConnectionLimiter()
    (listening,) = entry.bind("127.0.0.1", 0)
    listening.listen()
    listening.settimeout(0.0)
    address = listening.getsockname()
    callers = [socket.create_connection(address) for _ in range(3)]
    taken: list[Any] = []
    with few_descriptors(resource.getrlimit(resource.RLIMIT_NOFILE)[0]), contextlib.ExitStack() as stack:
        soft = max(int(entry.name) for entry in Path("/proc/self/fd").iterdir()) + 2
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
        with contextlib.suppress(OSError):
            while True:
                taken.append(stack.enter_context((tmp_path / "held").open("w")))
        for _ in callers:
            with pytest.raises(BlockingIOError):
                listening.accept()
    for caller in callers:
        assert caller.recv(1) == b""  # an end, and no wait
        caller.close()
    with socket.create_connection(address):
        wait_until(lambda: accepted(listening), "the next one is let in")
    entry.close()
    listening.close()


def accepted(listening: socket.socket) -> bool:
    with contextlib.suppress(BlockingIOError):
        listening.accept()[0].close()
        return True
    return False


def test_a_websocket_that_says_nothing_makes_room(subject: Path, serve: Callable[..., RunningServer]) -> None:
    """Also after the handshake, as many as there may be: who is honest speaks."""
    server = serve(subject)
    with contextlib.ExitStack() as stack:
        for _ in range(spec.LIMITS["connections"] + 10):
            raw = stack.enter_context(contextlib.closing(Raw(server.url)))
            assert raw.status == 101
        still_served(server)


def test_a_close_without_a_code_is_a_goodbye(server: RunningServer) -> None:
    """Its place is free for the next one at once."""
    for _ in range(3):
        with contextlib.closing(Raw(server.url)) as raw:
            answer = raw.ask(codec.encode(codec.Frame("hello", "e", {})))
            assert answer.message_type == "hello_ack"
            raw.send(CLOSE)
            assert raw.closed() == (1000, "")
    peer = Peer(server.url)
    assert peer.ask("hello").message_type == "hello_ack"
    peer.send("close")
    peer.close()
