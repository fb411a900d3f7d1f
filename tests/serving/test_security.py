from __future__ import annotations

import asyncio
import contextlib
import json
import pickle
import shutil
import ssl
import stat
import struct
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from tests.support.outside.raw import BINARY, CONTINUATION, PING, PONG, TEXT, Raw, dial, page
from tests.support.peer import DEADLINE_S, Peer, greeted, wait_until, xpl
from xpl import Client
from xpl import _spec as spec
from xpl.client import AsyncClient, PolicyServerError, ServerConnectionError
from xpl.wire import codec, packed
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.serving.launch import RunningServer, running_server
from xpl_cli.serving.secrets import read_token, server_tls_context

# Remembers which methods ran, so that a refused one shows.
SUBJECT = """
    class Model:
        def __init__(self, config):
            self.ran = []

        def update_obs(self, obs):
            self.ran.append("update_obs")

        def get_action(self):
            self.ran.append("get_action")
            return [1]

        def reset(self):
            self.ran = []

        def reset_envs(self, env_idx_list):
            self.ran.append("reset_envs")

        def infer(self, observation):
            self.ran.append("infer")

        def journal(self):
            return self.ran

        def fail(self):
            raise ValueError("the gripper is unhappy")

        def undeclared(self):
            self.ran.append("undeclared")

        def _private(self):
            self.ran.append("_private")
"""
SHORT: dict[str, Any] = {"handshake_timeout_s": 2.0, "close_timeout_s": 0.5}
TOKEN = "a-token-of-thirty-two-characters"
ONCE: dict[str, Any] = {"max_connect_attempts": 1, "connect_timeout_s": DEADLINE_S}
NO_HELLO = spec.CLOSE_CODES["no_hello"]
PROTOCOL_ERROR, TOO_BIG = 1002, 1009


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(SUBJECT, methods=["journal", "fail", "_private", "reset_envs"])


@pytest.fixture(scope="module")
def shared(subject: Path) -> Iterator[RunningServer]:
    with running_server(subject) as server:
        yield server


@pytest.fixture
def peer(shared: RunningServer) -> Iterator[Peer]:
    with greeted(shared.url) as connection:
        yield connection


@pytest.fixture
def raw(shared: RunningServer) -> Iterator[Raw]:
    """Return a connection to the server without a WebSocket library."""
    connection = Raw(shared.url)
    yield connection
    connection.close()


def message(kind: str = "heartbeat", payload: dict[str, Any] | None = None) -> bytes:
    return codec.encode(codec.Frame(kind, "e", payload or {}))


async def heartbeat(url: str, **options: Any) -> None:
    """Connect with the other client and ask for a sign of life."""
    async with AsyncClient(url, config=ONCE, **options) as client:
        await client.heartbeat()


# -- who may come in ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def token_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file with a token that nobody else may read."""
    return secret(tmp_path_factory.mktemp("secret") / "token", TOKEN + "\n")


def secret(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


@pytest.fixture(scope="module")
def guarded(subject: Path, token_file: Path) -> Iterator[RunningServer]:
    """Serve the adapter to whoever knows the token, on every address."""
    with running_server(subject, options=["--token-file", str(token_file), "--host", "0.0.0.0"]) as server:  # noqa: S104
        yield server


def test_the_token_lets_in(guarded: RunningServer) -> None:
    """Both clients send it, and a server with a token may listen on every address."""
    with Client(guarded.url, token=TOKEN, config=ONCE) as client:
        assert client.infer({}) == [1]
    asyncio.run(heartbeat(guarded.url, token=TOKEN))


@pytest.mark.parametrize("token", [None, "wrong", TOKEN[:-1], TOKEN + "x", TOKEN.upper()])
def test_no_token_or_another_one_is_refused_for_good(guarded: RunningServer, token: str | None) -> None:
    """With one sentence and without trying again, although the limits for connecting would allow it."""
    with pytest.raises(ServerConnectionError, match=r"requires another bearer token \(HTTP 401\)"):
        Client(guarded.url, token=token)
    with pytest.raises(ServerConnectionError, match=r"requires another bearer token \(HTTP 401\)"):
        asyncio.run(heartbeat(guarded.url, token=token))


@pytest.mark.parametrize(
    ("header", "status"),
    [
        (f"Bearer {TOKEN}", 200),
        (f"bearer {TOKEN}", 200),
        (TOKEN, 401),
        (f"Basic {TOKEN}", 401),
        ("Bearer", 401),
        ("Bearer ü", 401),
        ("", 401),
    ],
)
def test_plain_pages_ask_for_the_token_too(guarded: RunningServer, header: str, status: int) -> None:
    """In the scheme of the standard, and nothing of the token is in the refusal."""
    answer = page(guarded.url, "/healthz", Authorization=header)
    assert answer[0] == status
    assert TOKEN not in answer[1]


def test_the_token_is_not_in_the_log(guarded: RunningServer) -> None:
    """Whatever was logged of those who came in and those who did not."""
    assert not any(TOKEN in line for line in guarded.log)


@pytest.mark.parametrize(
    ("text", "mode", "problem"),
    [
        (TOKEN, 0o640, "others may read"),
        (TOKEN, 0o604, "others may read"),
        ("short", 0o600, "at least 16 characters, got 5"),
        ("", 0o600, "at least 16 characters, got 0"),
        ("two words that are long enough", 0o600, "must be one word"),
        ("ein-geheimnis-mit-ümlauten", 0o600, "cannot be read"),
        ("a-token-with-a\x07-bell-in-it", 0o600, "must be one word"),
    ],
)
def test_a_token_file_that_keeps_no_secret_is_refused(tmp_path: Path, text: str, mode: int, problem: str) -> None:
    """Open to others, too short, or more than a header can carry; the token itself is not shown."""
    with pytest.raises(UserError, match=problem) as refusal:
        read_token(secret(tmp_path / "token", text, mode))
    assert not text or text not in str(refusal.value)
    with pytest.raises(UserError, match="cannot be read"):
        read_token(tmp_path / "missing")


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--host", "0.0.0.0"], "without authentication the server listens on loopback only"),  # noqa: S104
        (["--token-file", "open"], "others may read the token file open"),
        (["--tls-key", "open"], "--tls-key needs --tls-cert"),
        (["--workers", "0"], "--workers must be at least 1, got 0"),
    ],
)
def test_what_is_not_safe_is_refused_before_anything_starts(
    subject: Path, tmp_path: Path, arguments: list[str], problem: str
) -> None:
    secret(tmp_path / "open", TOKEN, 0o644)
    run = xpl("serve", str(subject), "--port", "0", *arguments, cwd=tmp_path)
    assert (run.returncode, run.stdout) == (ExitCode.USAGE, "")
    assert problem in run.stderr
    assert "Traceback" not in run.stderr


# -- TLS ---------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a certificate for this machine and its key; the test is skipped where nothing makes one."""
    if not shutil.which("openssl"):
        pytest.skip("no openssl on PATH")
    folder = tmp_path_factory.mktemp("tls")
    files = folder / "cert.pem", folder / "key.pem"
    names = "subjectAltName=IP:127.0.0.1,DNS:localhost"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-subj", "/CN=localhost", "-addext", names, "-days", "2", "-out", str(files[0]), "-keyout"]
    subprocess.run([*command, str(files[1])], check=True, capture_output=True)
    return files


@pytest.fixture(scope="module")
def encrypted(subject: Path, certificate: tuple[Path, Path], token_file: Path) -> Iterator[RunningServer]:
    """Serve the adapter over TLS to whoever knows the token."""
    options = ["--tls-cert", str(certificate[0]), "--tls-key", str(certificate[1]), "--token-file", str(token_file)]
    with running_server(subject, options=options) as server:
        yield server


def test_both_clients_speak_tls(encrypted: RunningServer, certificate: tuple[Path, Path]) -> None:
    """With the token, and without shared memory: what is encrypted was meant to stay so."""
    assert encrypted.url.startswith("wss://")
    trust = ssl.create_default_context(cafile=certificate[0])
    large = {"vision": {"cam_head": {"color": np.zeros((480, 640, 3), np.uint8)}}}
    with Client(encrypted.url, token=TOKEN, ssl_context=trust, config=ONCE) as client:
        assert "shared_memory" not in client.capabilities
        assert client.infer(large) == [1]
    asyncio.run(heartbeat(encrypted.url, token=TOKEN, ssl_context=trust))


def test_a_certificate_that_is_not_trusted_is_refused_for_good(encrypted: RunningServer) -> None:
    with pytest.raises(ServerConnectionError, match=r"no secure connection to wss://.*CERTIFICATE_VERIFY_FAILED"):
        Client(encrypted.url, token=TOKEN)
    with pytest.raises(ServerConnectionError, match=r"no secure connection to wss://.*CERTIFICATE_VERIFY_FAILED"):
        asyncio.run(heartbeat(encrypted.url, token=TOKEN))


def test_nothing_is_said_in_the_clear_to_a_server_with_tls(
    encrypted: RunningServer, certificate: tuple[Path, Path]
) -> None:
    """A client that forgets the s is not served, and others still are."""
    with pytest.raises(ServerConnectionError, match="after 1 attempts"):
        Client(encrypted.url.replace("wss", "ws"), token=TOKEN, config=ONCE)
    trust = ssl.create_default_context(cafile=certificate[0])
    with Client(encrypted.url, token=TOKEN, ssl_context=trust, config=ONCE) as client:
        client.heartbeat()


def test_files_that_make_no_pair_are_refused(certificate: tuple[Path, Path], tmp_path: Path) -> None:
    """By name; a key with a password does not have the server wait for someone to type it."""
    cert, key = certificate
    locked = tmp_path / "locked.pem"
    command = ["openssl", "ec", "-in", str(key), "-aes256", "-passout", "pass:secret", "-out", str(locked)]
    subprocess.run(command, check=True, capture_output=True)
    for pair in ((cert, cert), (key, key), (cert, tmp_path / "missing"), (cert, locked), (cert, None)):
        with pytest.raises(UserError, match=f"TLS: {cert.parent}.* cannot be used"):
            server_tls_context(*pair)
    with pytest.raises(UserError, match="--tls-key needs --tls-cert"):
        server_tls_context(None, key)
    assert server_tls_context(None, None) is None


# -- how much one may ask for ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hasty(subject: Path) -> Iterator[RunningServer]:
    with running_server(subject, SHORT) as server:
        yield server


def test_connections_that_say_nothing_are_ended(hasty: RunningServer) -> None:
    """Once the handshake's time is over, a WebSocket with the wire's code; one that spoke may be silent afterwards."""
    begun = (b"", b"GET / HTTP/1.1\r\nHost: x\r\n")
    with greeted(hasty.url) as client, contextlib.closing(Raw(hasty.url)) as silent, contextlib.ExitStack() as stack:
        connections = [stack.enter_context(dial(hasty.url)) for _ in begun]
        for connection, data in zip(connections, begun, strict=True):
            connection.sendall(data)
        assert silent.closed() == (NO_HELLO, "no message within 2 s")
        for connection in connections:
            with contextlib.suppress(ConnectionResetError):
                while connection.recv(4096):
                    pass
        assert client.ask("heartbeat").message_type == "heartbeat_ack"


def test_the_number_of_connections_is_limited(hasty: RunningServer) -> None:
    """One too many is told why in plain HTTP, and a place is free when another one leaves."""
    with contextlib.ExitStack() as stack:
        connections: list[Raw] = []

        def fill() -> Raw:
            connection = Raw(hasty.url)
            stack.callback(connection.close)
            if connection.status == 101:
                connection.ask(message())
                connections.append(connection)
            return connection

        for _ in range(spec.LIMITS["connections"]):
            assert fill().status == 101
        assert fill().status == 503
        status, text = page(hasty.url, "/")
        assert (status, text) == (503, f"{spec.LIMITS['connections']} connections are enough\n")
        state = json.loads(page(hasty.url, "/healthz")[1])
        assert (state["state"], state["connections"]) == ("ready", spec.LIMITS["connections"])
        connections.pop().close()
        wait_until(lambda: fill().status == 101, "there is room again")


# -- what is said ------------------------------------------------------------------------------------------------------


def test_a_frame_over_the_limit_closes_the_connection(raw: Raw, shared: RunningServer) -> None:
    """By what its header says, before anything of that size is taken in."""
    raw.send(BINARY, b"x" * 100, size=spec.LIMITS["frame_bytes"] + 1)
    assert raw.closed()[0] == TOO_BIG
    with contextlib.closing(Raw(shared.url)) as other:
        assert other.ask(message()).message_type == "heartbeat_ack"


def test_fragments_are_put_together(raw: Raw) -> None:
    """As many as there are, empty ones too, with control frames between them."""
    data = message()
    raw.send(BINARY, data[:10], last=False)
    raw.send(PING, b"ping")
    raw.send(CONTINUATION, b"", last=False)
    for byte in data[10:-1]:
        raw.send(CONTINUATION, bytes([byte]), last=False)
    raw.send(CONTINUATION, data[-1:])
    assert raw.receive() == (PONG, b"ping")
    assert codec.decode(raw.receive()[1]).message_type == "heartbeat_ack"
    assert raw.ask(message()).message_type == "heartbeat_ack"


def test_fragments_are_limited_in_sum(raw: Raw) -> None:
    """No part of them is over the limit of a frame."""
    part = bytes(spec.LIMITS["frame_bytes"] // 4)
    raw.send(BINARY, part, last=False)
    with contextlib.suppress(ConnectionError):  # the server may be gone before it has read all of it
        for _ in range(4):
            raw.send(CONTINUATION, part, last=False)
    assert raw.closed()[0] == TOO_BIG


@pytest.mark.parametrize(
    "frames",
    [[(CONTINUATION, True)], [(BINARY, False), (BINARY, True)], [(BINARY, False), (TEXT, False)]],
    ids=["no beginning", "a whole one between", "a second beginning"],
)
def test_fragments_out_of_order_close_the_connection(raw: Raw, frames: list[tuple[int, bool]]) -> None:
    """They could be read in more than one way."""
    for kind, last in frames:
        raw.send(kind, b"x", last=last)
    assert raw.closed() == (PROTOCOL_ERROR, "fragments out of order")


@pytest.mark.parametrize("reserved", [1, 2, 4])
def test_reserved_bits_close_the_connection(raw: Raw, reserved: int) -> None:
    """No extension was agreed on, so nobody knows what they mean."""
    raw.send(BINARY, message(), reserved=reserved)
    assert raw.closed() == (PROTOCOL_ERROR, "no extension was agreed on")


def test_a_text_message_is_passed_over(raw: Raw, shared: RunningServer) -> None:
    """The wire is binary; the log says so, and the connection lives."""
    raw.send(TEXT, b"GET / HTTP/1.1")
    raw.send(TEXT, b"in two", last=False)
    raw.send(CONTINUATION, b" parts")
    assert raw.ask(message()).message_type == "heartbeat_ack"
    wait_until(lambda: sum("ignored a text message" in line for line in shared.log) >= 2, "it is in the log")


def test_nesting_is_limited(peer: Peer) -> None:
    """Also where the frame was written by another library."""
    nested: Any = 0
    for _ in range(spec.LIMITS["nesting"] + 1):
        nested = [nested]
    fields = vars(codec.Frame("infer", peer.evaluation_id, {"observation": {"n": nested}}))
    peer.socket.send(msgpack.packb(fields))
    answer = peer.receive()
    assert answer.message_id == fields["message_id"]
    assert "nested deeper" in answer.payload["message"]


class Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self._path,)


@pytest.mark.parametrize("form", ["wire", "packed"])
@pytest.mark.parametrize("kind", ["|O", "O", "object", "<M8[D]", [["a", "|O"]]])
def test_objects_are_refused_and_nothing_is_unpickled(peer: Peer, tmp_path: Path, form: str, kind: Any) -> None:
    """In either form of an array, at its top or in a field."""
    trap = pickle.dumps(Trap(tmp_path / "sprung"))
    if form == "wire":
        array = {b"nd": True, b"type": kind, b"kind": b"O", b"shape": [1], b"data": trap}
        fields = vars(codec.Frame("infer", peer.evaluation_id, {"observation": {"x": array}}))
        peer.socket.send(msgpack.packb(fields))
        answer = peer.receive()
    else:
        answer = ask_packed(peer, {"observation": {"x": {"@array": [0, kind, [1]]}}}, trap)
    assert (answer.message_type, answer.payload["code"]) == ("error", "invalid_frame")
    assert not (tmp_path / "sprung").exists()
    assert peer.ask("call", {"func_name": "journal"}).payload["result"] == []


@pytest.mark.parametrize(
    "name",
    [
        "_private",
        "__init__",
        "__class__",
        "undeclared",
        "infer",
        "reset_envs",
        "ran",
        "prepare_case",
        "load",
        "a.b",
        "",
    ],
)
def test_only_what_the_contract_or_the_adapter_names_is_called(peer: Peer, name: str) -> None:
    """Not even a private name that the manifest declares, nor what the front end itself uses."""
    for obs in ({}, {"obs": {}}, {"obs": [0]}):
        answer = peer.ask("call", {"func_name": name, **obs})
        assert (answer.message_type, answer.payload["code"]) == ("error", "invalid_frame")
    assert peer.ask("call", {"func_name": "journal"}).payload["result"] == []


def test_tracebacks_are_sent_with_debug_only(
    peer: Peer, subject: Path, serve: Callable[..., RunningServer], shared: RunningServer
) -> None:
    """One sentence otherwise, and the log has the rest."""
    sentence = peer.ask("call", {"func_name": "fail"}).payload["message"]
    assert sentence == "ValueError: the gripper is unhappy"
    wait_until(lambda: any("in fail" in line for line in shared.log), "the traceback is in the log")
    with greeted(serve(subject, options=["--debug"]).url) as other:
        told = other.ask("call", {"func_name": "fail"}).payload["message"]
    assert told.startswith("Traceback (most recent call last)")
    assert "in fail\n" in told
    assert told.rstrip().endswith(sentence)


def test_lines_of_the_adapter_are_sent_to_an_audit_only(
    peer: Peer, subject: Path, serve: Callable[..., RunningServer]
) -> None:
    """A client of any other server does not learn where the adapter's files raise."""
    assert (
        "details" not in peer.ask("call", {"func_name": "fail"}).payload
        or not peer.ask("call", {"func_name": "fail"}).payload["details"]
    )
    with greeted(serve(subject, options=["--locate-errors"]).url) as other:
        ((file, line, name),) = other.ask("call", {"func_name": "fail"}).payload["details"]["raised_at"]
    assert (file, name) == ("model.py", "fail")
    assert "the gripper is unhappy" in (subject / file).read_text().splitlines()[line - 1]


# -- packed payloads and shared memory ---------------------------------------------------------------------------------


def ask_packed(peer: Peer, tree: Any, body: bytes = b"", header: bytes | None = None) -> codec.Frame:
    """Send an infer whose observation is packed by hand, and return the answer."""
    text = json.dumps(tree).encode() if header is None else header
    data = struct.pack("<4sIQ", b"XPL1", len(text), len(body)) + text + body
    return peer.ask("infer", {"packed": data})


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", "begins with"),
        (b"XPL1", "begins with"),
        (b"XPL2" + bytes(12), "out of step"),
        ("text", "begins with"),
        (struct.pack("<4sIQ", b"XPL1", 2, 5) + b"{}", "damaged"),
        (struct.pack("<4sIQ", b"XPL1", 2, 0) + b"{}more", "damaged"),
        (struct.pack("<4sIQ", b"XPL1", 1, 2**63) + b"{}", "over the limits"),
        (struct.pack("<4sIQ", b"XPL1", 2, 0) + b"{]", "do not fit together"),
        (struct.pack("<4sIQ", b"XPL1", 2, 0) + b"[]", "must be a map"),
        (struct.pack("<4sIQ", b"XPL1", 2, 0) + b"{}", "infer needs a payload with an observation map"),
        (struct.pack("<4sIQ", b"XPL1", spec.LIMITS["packed_header"] + 16, 0) + b"{}" + b" " * (2**20 + 14), "header"),
    ],
)
def test_a_damaged_packed_payload_is_refused(peer: Peer, data: Any, problem: str) -> None:
    """With what is wrong with it; the worker and the connection live."""
    answer = peer.ask("infer", {"packed": data})
    assert (answer.message_type, answer.payload["code"]) == ("error", "invalid_frame")
    assert problem in answer.payload["message"]
    assert peer.ask("call", {"func_name": "journal"}).payload["result"] == []


@pytest.mark.parametrize(
    "place",
    [
        [0, 4096],
        [5, 4096],
        [-1, 4096],
        [0, 0],
        [0, 64],
        [0, 2**40],
        [2**40, 4096],
        ["0", 4096],
        [True, 4096],
        [0, None],
    ],
    ids=str,
)
@pytest.mark.parametrize("agreed", [False, True], ids=["nothing shared", "shared"])
def test_memory_that_was_not_given_is_not_read(shared: RunningServer, place: list[Any], agreed: bool) -> None:
    """Blocks that hold no array of this client, places outside the data, and memory that was never agreed on."""
    with greeted(shared.url) as peer:
        if agreed:
            share(peer)
        answer = ask_packed(peer, {"observation": {"x": {"@shared": [*place, "|u1", [16384]]}}})
        assert (answer.message_type, answer.payload["code"]) == ("error", "invalid_frame")
        assert "shared memory" in answer.payload["message"]
        assert peer.ask("call", {"func_name": "journal"}).payload["result"] == []


def offered(peer: Peer) -> dict[str, Any]:
    """Return what the server offers of shared memory."""
    answer = peer.ask("hello", {"capabilities": {"shared_memory": {"wanted": True}}})
    offer: dict[str, Any] = answer.payload["capabilities"]["shared_memory"]
    return offer


def share(peer: Peer) -> Path:
    """Agree on shared memory as a client does, and return its path."""
    path = Path(offered(peer)["path"])
    with path.open("r+b") as file:
        proof = file.read(16).hex()
        file.seek(16)
        file.write(b"sixteen bytes ok")
    answer = peer.ask("hello", {"capabilities": {"shared_memory": {"proof": proof}}})
    assert answer.payload["capabilities"]["shared_memory"] == {"proof": b"sixteen bytes ok".hex()}
    return path


def test_shared_memory_is_closed_to_others_and_loses_its_name(shared: RunningServer) -> None:
    """Mode 0600 from the first moment; once both sides have proved that they see it, nobody else can open it."""
    with greeted(shared.url) as peer:
        path = Path(offered(peer)["path"])
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    wait_until(lambda: not path.exists(), "an offer that was not taken is gone with the connection")
    with greeted(shared.url) as peer:
        path = share(peer)
        wait_until(lambda: not path.exists(), "the name is taken away")


def test_a_client_that_shrinks_its_memory_is_refused_and_ends_nothing(shared: RunningServer) -> None:
    """The worker that reads there may serve others."""
    with greeted(shared.url) as peer:
        path = Path(offered(peer)["path"])
        with path.open("r+b") as file:
            proof = file.read(16).hex()
            file.seek(spec.SHARED_MEMORY["states_at"])
            file.write(bytes((spec.SHARED_MEMORY["sent"],)))
            file.flush()
            peer.ask("hello", {"capabilities": {"shared_memory": {"proof": proof}}})
            peer.ask("reset")
            for left, said in ((spec.SHARED_MEMORY["data_at"] + 8, "has shrunk"), (0, "holds no array")):
                file.truncate(left)
                answer = ask_packed(peer, {"observation": {"x": {"@shared": [0, 4096, "|u1", [16384]]}}})
                assert (answer.message_type, answer.payload["code"]) == ("error", "invalid_frame")
                assert said in answer.payload["message"]
        assert peer.ask("reset").message_type == "reset_result"


@pytest.mark.parametrize("proof", ["", "00" * 16, None, 3, b"x", {"proof": "x"}])
def test_a_wrong_proof_shares_nothing(shared: RunningServer, proof: Any) -> None:
    """The worker never maps it, so its blocks cannot be named."""
    with greeted(shared.url) as peer:
        offered(peer)
        answer = peer.ask("hello", {"capabilities": {"shared_memory": {"proof": proof}}})
        assert "shared_memory" not in answer.payload["capabilities"]
        answer = ask_packed(peer, {"observation": {"x": {"@shared": [0, 4096, "|u1", [16384]]}}})
        assert "agreed on none" in answer.payload["message"]


def test_what_the_header_may_hold_is_limited_for_clients_too(shared: RunningServer) -> None:
    """`Client` sends longer lists and texts unpacked, and the adapter gets them all the same."""
    with Client(shared.url) as client:
        assert client.infer({"instruction": "x" * (spec.LIMITS["packed_header"] + 1)}) == [1]
        with pytest.raises(PolicyServerError, match="no method 'undeclared'"):
            client.call("undeclared", {"text": "x" * (spec.LIMITS["packed_header"] + 1)})


def test_packed_and_plain_say_the_same(shared: RunningServer) -> None:
    """What was refused above is refused for its content: the form itself is taken, and given to who announced it."""
    pieces = b"".join(map(bytes, packed.encode({"observation": {"x": np.arange(5)}})))
    with greeted(shared.url) as peer:
        assert peer.ask("infer", {"packed": pieces}).payload["actions"] == [1]
    with greeted(shared.url, packed=1) as peer:
        assert packed.decode(peer.ask("infer", {"packed": pieces}).payload["packed"]) == {"actions": [1]}


RAISES = """
    class Model:
        number = 0
        def __init__(self, config): pass
        def reset(self):
            self.number += 1
            raise ValueError(f"number {self.number}")
"""


def test_the_log_takes_so_many_errors_of_an_adapter_and_counts_the_rest(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    """A client may have it raise as often as it asks, and must not fill the disk with tracebacks."""
    server = serve(write_adapter(RAISES))
    with greeted(server.url) as peer:
        for _ in range(150):
            assert peer.ask("reset").payload["code"] == "reset_failed"
    wait_until(lambda: any("number 100" in line for line in server.log), "it is logged")
    assert not any("number 101" in line for line in server.log)
