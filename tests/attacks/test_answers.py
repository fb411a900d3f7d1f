"""What a model may answer or raise: there is an answer that can be sent, for everyone who asked."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.killable import listens
from tests.support.outside.raw import page
from tests.support.peer import Peer, greeted, wait_until
from xpl import Client
from xpl import _spec as spec
from xpl.wire import codec, error_text, packed
from xpl_cli.serving.launch import RunningServer, running_server
from xpl_cli.serving.requests import RequestError

MODEL = """
    import asyncio
    import numpy as np

    class Unspeakable(Exception):
        def __str__(self): raise RuntimeError("no text")
        __repr__ = __str__

    class Wordless(Exception):
        def __str__(self): return 3

    class Stops(BaseException):
        def __str__(self): raise KeyboardInterrupt

    class Unsized(list):
        def __len__(self): raise GeneratorExit

    class Endless(dict):
        def items(self): raise Stops

    class Hidden(type):
        def __getattribute__(self, name):
            if name in ("__name__", "__qualname__", "__module__"): raise ValueError("no name")
            return type.__getattribute__(self, name)

    class Nameless(Exception, metaclass=Hidden): pass

    class Crowd(Exception):
        def __init__(self, members): self.exceptions = members

    def crowd():
        error = ValueError("the last")
        for _ in range(40): error = Group("crowd", [error, error])
        return error

    Group = getattr(__builtins__, "ExceptionGroup", None) or (
        __builtins__.get("ExceptionGroup") if isinstance(__builtins__, dict) else None) or (lambda _, all: Crowd(all))

    def chain():
        error = None
        for number in range(20_000):
            error, before = ValueError(number), error
            error.__cause__ = before
        return error

    def from_nowhere():
        try: exec(compile("raise ValueError('from nowhere')", "/dev/zero", "exec"))
        except ValueError as error: return error

    def loop():
        error = ValueError("a circle")
        error.__cause__ = ValueError("again")
        error.__cause__.__cause__ = error
        return error

    def itself():
        inside = []
        inside.append(inside)
        return inside

    RAISED = {
        "surrogate": lambda: ValueError("a \\udc80 in it"),
        "surrogate in a key": lambda: KeyError("\\udc80"),
        "surrogate in a name": lambda: type("Odd\\udfff", (Exception,), {})("x"),
        "unspeakable": Unspeakable,
        "wordless": Wordless,
        "stops": Stops,
        "long": lambda: ValueError("x" * 40_000_000),
        "interrupt": KeyboardInterrupt,
        "generator": GeneratorExit,
        "cancelled": asyncio.CancelledError,
        "base": lambda: BaseException("base"),
        "exit": lambda: SystemExit(Unspeakable()),
        "loop": loop,
        "escapes": lambda: ValueError("\\x1b[31mred\\n[server] all is well\\nerror: forged"),
        "unicode": lambda: "\\ud800".encode(),
        "nameless": Nameless,
        "crowd": crowd,
        "chain": chain,
        "from nowhere": from_nowhere,
    }
    RETURNED = {
        "surrogate": lambda: "\\udc80",
        "surrogate key": lambda: {"\\udc80": np.zeros(3)},
        "rows with one": lambda: [{"\\udc80": np.zeros(3)}, {"\\udc80": np.zeros(3)}],
        "many rows": lambda: [{"a": np.zeros(3), "b": np.zeros(3)}] * 3_000_000,
        "many numbers": lambda: list(range(5_000_000)),
        "many lists": lambda: [[]] * 5_000_000,
        "large": lambda: np.zeros(1 << 29, np.int8),
        "itself": itself,
        "an error": lambda: Unspeakable(),
        "object": object,
        "unsized": lambda: Unsized([1]),
        "endless": Endless,
        "generator": lambda: (number for number in range(3)),
        "dates": lambda: np.zeros(3, "M8[s]"),
    }

    class Model:
        def __init__(self, config): self.keys = []
        def update_obs(self, obs): self.obs = obs
        def update_obs_batch(self, batch): self.batch = batch
        def get_action_batch(self, envs=None): return [self.infer(self.batch[0]) for _ in envs or [0]]
        def reset_envs(self, envs): pass
        def get_action(self): return self.infer(self.obs)
        def reset(self): pass
        def infer(self, observation):
            if "raise" in observation:
                error = RAISED[observation["raise"]]()
                raise error
            if "return" in observation:
                return RETURNED[observation["return"]]()
            return [1]
"""
RAISED = [
    "surrogate", "surrogate in a key", "surrogate in a name", "unspeakable", "wordless", "stops", "long", "interrupt",
    "generator", "cancelled", "base", "exit", "loop", "escapes", "unicode",
    "nameless", "crowd", "chain", "from nowhere",
]  # fmt: skip
RETURNED = [
    "surrogate", "surrogate key", "rows with one", "many rows", "many numbers", "many lists", "large", "itself",
    "an error", "object", "unsized", "endless", "generator", "dates",
]  # fmt: skip
LONGEST = 3 * error_text.SENTENCE


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(MODEL)


@pytest.fixture(scope="module")
def server(subject: Path) -> Iterator[RunningServer]:
    """Serve it to one client at a time."""
    with running_server(subject) as running:
        yield running


def worker(server: RunningServer) -> int:
    number: int = json.loads(page(server.url, "/healthz")[1])["workers"][0]["process"]
    return number


@pytest.mark.sampled(12)
@pytest.mark.parametrize("capabilities", [{}, {"packed": 1}], ids=["plain", "packed"])
@pytest.mark.parametrize(
    "what", [("raise", name) for name in RAISED] + [("return", name) for name in RETURNED], ids=str
)
def test_there_is_always_an_answer(server: RunningServer, what: tuple[str, str], capabilities: dict[str, Any]) -> None:
    """An error that can be read, of a bounded length, and the same worker goes on."""
    before = worker(server)
    with greeted(server.url, **capabilities) as peer:
        answer = peer.ask("infer", {"observation": {what[0]: what[1]}})
        assert answer.message_type == "error", answer
        assert len(answer.payload["message"]) <= LONGEST
        assert answer.payload["message"].encode()
        assert peer.ask("infer", {"observation": {}}).message_type == "infer_result"
    assert worker(server) == before


def test_the_log_of_an_error_is_not_forged(server: RunningServer) -> None:
    """What an exception says begins no line of its own, and moves no cursor."""
    with greeted(server.url) as peer:
        peer.ask("infer", {"observation": {"raise": "escapes"}})
        wait_until(lambda: any("all is well" in line for line in server.log), "it is logged")
    assert not any("\x1b" in line or line.startswith(("error: ", "[server] all is well")) for line in server.log)


def test_the_log_of_a_frame_is_not_forged(server: RunningServer) -> None:
    with greeted(server.url) as peer:
        peer.send("\n[server] all is well\x1b[2J")
        peer.receive()
        peer.send("reset", {}, message_id="\x1b]0;title\x07", trial_id="\n[server] all is well")
        peer.receive()
        assert peer.ask("call", {"func_name": "\n[server] all is well\x9b"}).message_type == "error"
        nd = {b"nd": True, b"type": "\n[server] all is well\x1b", b"data": b"", b"shape": []}
        fields = msgpack.unpackb(codec.encode(codec.Frame("infer", "e", {"observation": {}})))
        peer.socket.send(msgpack.packb({**fields, "payload": {"observation": nd}}))
        peer.receive()
    wait_until(lambda: any("refused a frame" in line for line in server.log), "it is logged")
    assert not any("\x1b" in line or line.startswith("[server] all is well") for line in server.log)


def test_one_client_of_a_shared_model_never_costs_another_its_answer(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    server = serve(write_adapter(MODEL, serving={"shared": True}))
    with greeted(server.url) as bad, greeted(server.url) as good:
        for name in ("surrogate", "unspeakable", "stops", "generator"):
            bad.send("infer", {"observation": {"raise": name}})
            good.send("infer", {"observation": {"raise": name}})
            assert bad.receive().message_type == "error"
            assert good.receive().message_type == "error"
            assert good.ask("infer", {"observation": {}}).message_type == "infer_result"


@settings(max_examples=examples(60), deadline=None)
@given(
    st.text(),
    st.recursive(
        st.none() | st.text() | st.binary() | st.integers() | st.floats() | st.builds(np.zeros, st.integers(0, 3)),
        lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.binary() | st.integers(), inner),
        max_leaves=20,
    ),
)
def test_every_refusal_can_be_sent(message: str, details: Any) -> None:
    """Whatever is in its sentence or its details."""
    error = RequestError(spec.ErrorCode.INTERNAL, message, differences=details)
    assert codec.decode(codec.encode(codec.Frame("error", "e", error.payload()))).payload["code"] == "internal"


def test_a_trace_that_cannot_be_written_ends_and_nothing_else(
    subject: Path, serve: Callable[..., RunningServer]
) -> None:
    """A full disk is said once, and requests are answered as before."""
    server = serve(subject, options=["--trace", "/dev/full"])
    with Client(server.url) as client:
        assert client.infer({}) == [1]
        assert client.infer({}) == [1]
        wait_until(lambda: any("the trace ends here" in line for line in server.log), "it is said")
    assert sum("the trace ends here" in line for line in server.log) == 1


# -- hello -------------------------------------------------------------------------------------------------------------

ODD = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats()
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
    | st.binary(max_size=8)
    | st.builds(np.arange, st.integers(0, 3))
    | st.builds(np.float32, st.integers(0, 3)),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["embodiment", "action_type", "control_frequency", "inputs", "cameras", "width", "height"])
            | st.sampled_from(["packed", "sequence", "session", "shared_memory", "proof", "loading", "jpeg"])
            | st.text(st.characters(exclude_categories=["Cs"]), max_size=4),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)
HELLOS: dict[str, Mapping[str, Any]] = {
    "an array": {"environment": {"embodiment": np.arange(3)}},
    "arrays": {"environment": {"inputs": [np.arange(3)], "cameras": {"cam_head": {"width": np.arange(2)}}}},
    "no map": {"environment": np.arange(3)},
    "a frequency": {"environment": {"control_frequency": np.arange(2)}},
    "capabilities": {"capabilities": np.arange(2)},
    "a capability": {"capabilities": {"packed": np.arange(2), "loading": np.arange(2)}},
    "a session": {"capabilities": {"session": np.arange(2)}},
    "many": {"capabilities": {"jpeg": list(range(100_000))}},
}


@pytest.mark.parametrize("hello", HELLOS.values(), ids=HELLOS)
def test_a_hello_of_another_kind_is_refused(server: RunningServer, hello: Mapping[str, Any]) -> None:
    """With what is wrong with it, and no traceback in the log."""
    before = len(server.log)
    with contextlib.closing(Peer(server.url)) as peer:
        answer = peer.ask("hello", hello)
        assert (answer.message_type, answer.payload["code"]) == ("error", "invalid_frame")
        assert "of hello" in answer.payload["message"]
        peer.send("close")
    assert not any("Traceback" in line for line in list(server.log)[before:])


def test_any_hello_is_answered(server: RunningServer) -> None:
    """By an acknowledgement or a refusal that is no fault of the server."""
    with contextlib.closing(Peer(server.url)) as peer:

        @settings(max_examples=examples(60), deadline=None, database=None)
        @given(st.fixed_dictionaries({}, optional={"environment": ODD, "capabilities": ODD, "evaluation_plan": ODD}))
        def ask(payload: dict[str, Any]) -> None:
            answer = peer.ask("hello", payload)
            assert answer.message_type == "hello_ack" or answer.payload["code"] == "invalid_frame", answer

        ask()
        peer.send("close")


def test_a_bad_hello_does_not_end_a_server_that_loads(write_adapter: Callable[..., Path], fifo: Path) -> None:
    """It is refused at once, and who waits for the model is greeted when it is there."""
    model = f"open({str(fifo)!r}).read()\n" + MODEL.replace("\n    ", "\n")
    folder = write_adapter(model)
    command = [sys.executable, "-m", "xpl_cli", "serve", str(folder), "--port", "0", "--host", "127.0.0.1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        url = f"ws://127.0.0.1:{wait_until(lambda: listens(process.pid), 'it listens')}"
        patient = Peer(url)
        patient.send("hello", {"capabilities": {}})
        for hello in HELLOS.values():
            with contextlib.closing(Peer(url)) as peer:
                assert peer.ask("hello", hello).message_type == "error"
        fifo.write_text("go")
        assert patient.receive().message_type == "hello_ack"
        patient.close()
        assert process.stdout is not None
        assert b"ready" in process.stdout.readline()
    finally:
        process.terminate()
        process.communicate()
    assert process.returncode == 0


# -- what fills the memory ---------------------------------------------------------------------------------------------


def test_structures_that_a_client_makes_up_are_not_kept() -> None:
    """Each frame can describe another one, of thousands of fields."""

    def read(name: str) -> None:
        kind = [[f"{name}{number}", "<f4"] for number in range(1000)]
        tree = json.dumps({"@array": [0, kind, [0]]}).encode()
        header = b"XPL1" + len(tree).to_bytes(4, "little") + bytes(8)
        packed.decode(header + tree)

    read("warm")
    tracemalloc.start()
    try:
        for number in range(20):
            read(f"n{number}-")
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 200_000


def test_a_structure_of_too_many_fields_is_refused() -> None:
    kind = [[f"f{number}", "<f4"] for number in range(5000)]
    tree = json.dumps({"@array": [0, kind, [0]]}).encode()
    with pytest.raises(packed.PackingError, match="fields"):
        packed.decode(b"XPL1" + len(tree).to_bytes(4, "little") + bytes(8) + tree)
