"""What an adapter writes to the link of its worker itself: it ends the worker, and costs the server nothing else."""

from __future__ import annotations

import contextlib
import json
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.peer import greeted
from xpl.process import link
from xpl.wire.process_frame import PREFIX_BYTES, PackingError
from xpl_cli.serving.workers import worker_answers
from xpl_cli.serving.workers.process import ANSWER_BYTES

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from xpl_cli.serving.launch import RunningServer

MODEL = """
    import os, socket, stat, struct

    def write(announced, data):
        for entry in os.listdir("/proc/self/fd"):
            if os.path.islink("/proc/self/fd/" + entry) and stat.S_ISSOCK(os.stat(int(entry)).st_mode):
                channel = socket.socket(fileno=os.dup(int(entry)))
                channel.sendall(b"XPL1" + struct.pack("<IQ", *announced) + data)

    class Model:
        def __init__(self, config): pass
        def update_obs(self, obs): self.obs = obs
        def reset(self): pass
        def get_action(self):
            if "data" in self.obs:
                write(self.obs["announced"], self.obs["data"])
            return [1]
"""


def message(text: str) -> dict[str, Any]:
    data = text.encode()
    return {"announced": [len(data), 0], "data": data}


RESULT = b"?" * (1 << 16)
FORGED = {
    "numbers of no use": message('[{"ok": NaN, "answers": [Infinity]}, []]'),
    "no map": message("[NaN, []]"),
    "errors of other types": message('[{"answers": [{"type": 1, "message": [], "traceback": null}]}, []]'),
    "more answers than requests": message('[{"answers": [null, null]}, []]'),
    "a large body": {"announced": [16, ANSWER_BYTES + 1], "data": b" " * 16},
    "a large head": {"announced": [link.HEAD_LIMIT + 32, 0], "data": b" " * 32},
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", FORGED)
def test_what_was_not_agreed_on_ends_the_worker(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer], name: str
) -> None:
    """The client is told, and nothing is a fault of the server's."""
    server = serve(write_adapter(MODEL))
    with greeted(server.url) as peer:
        assert peer.ask("infer", {"observation": {}}).message_type == "infer_result"
        answer = peer.ask("infer", {"observation": FORGED[name]})
    assert (answer.message_type, answer.payload["details"]["reason"]) == ("error", "worker_died")
    assert "the link to the worker" in answer.payload["message"]
    assert not any("Traceback" in line or "fault of" in line for line in server.log)


def test_a_result_that_is_no_packed_value_is_a_sentence(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    head = b'[{"answers": [null]}, [%d]]' % len(RESULT)
    head += b" " * (-len(head) % 16)
    server = serve(write_adapter(MODEL))
    with greeted(server.url) as peer:
        observation = {"announced": [len(head), len(RESULT)], "data": head + RESULT}
        answer = peer.ask("infer", {"observation": observation})
    assert (answer.message_type, answer.payload["code"]) == ("error", "internal")
    assert "a frame begins with" in answer.payload["message"]
    assert not any("Traceback" in line or "fault of" in line for line in server.log)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner)
        | st.dictionaries(st.sampled_from(["type", "message", "traceback", "lacks", "kind", "name"]), inner)
        | st.dictionaries(st.text(), inner)
    ),
    max_leaves=12,
)


@settings(max_examples=examples(200), deadline=None)
@given(told=anything, results=st.integers(0, 3), count=st.integers(0, 3))
def test_a_head_is_understood_or_refused_in_one_sentence(told: Any, results: int, count: int) -> None:
    with contextlib.suppress(worker_answers.WorkerAnswerError):
        assert len(worker_answers.parse_answers({"answers": told}, [memoryview(b"")] * results, count)) == count
    for head in ({"ok": told}, {"error": told}):
        with contextlib.suppress(worker_answers.WorkerAnswerError):
            assert told is None or isinstance(worker_answers.parse_result(head), dict | worker_answers.AdapterException)
    with pytest.raises(worker_answers.WorkerAnswerError, match="expected ok or error"):
        worker_answers.parse_result({"other": told})


def test_a_head_is_small() -> None:
    """Both sides hold to it: a head of lists takes many times its size in memory."""
    with pytest.raises(PackingError, match="use arrays"):
        link.encode(["x" * link.HEAD_LIMIT])
    (piece,) = link.encode({"op": "run"})
    head, buffers = link.decode(piece)
    assert (head, buffers) == ({"op": "run"}, [])
    assert json.loads(bytes(piece[PREFIX_BYTES:])) == [{"op": "run"}, []]
