from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from tests.support.peer import DEADLINE_S, MARK, Peer, greeted, processes, wait_until
from xpl import Client, image_codec
from xpl import _spec as spec
from xpl.wire import codec
from xpl_cli.basics.errors import ExitCode
from xpl_cli.serving.launch import RunningServer, ServerStartError, running_server

# Counts what runs, shows what it was given, and does on request everything an adapter should not do.
SUBJECT = """
    import os, sys, time
    import numpy as np


    class Model:
        def __init__(self, config):
            print("the model prints while it loads")
            self.config, self.runs, self.seen, self.events = config, 0, [], []

        def update_obs(self, obs):
            self.seen.append(obs)
            self.events.append(("update_obs", obs.get("n")))

        def update_obs_batch(self, obs_list):
            self.seen.extend(obs_list)

        def get_action(self):
            self.runs += 1
            self.events.append(("get_action", None))
            wanted = self.seen[-1].get("do") if self.seen else None
            if wanted == "wait":
                open(self.seen[-1]["fifo"]).read()  # until someone opens it for writing and closes it
            if wanted == "raise":
                raise ValueError("the gripper is unhappy")
            if wanted == "exit":
                sys.exit(3)
            if wanted == "print":
                print("x" * 200_000)
                os.write(1, b"raw bytes \\xff on descriptor 1\\n")
                sys.__stdout__.write("and on the first stdout")
            if wanted == "map":
                return {"actions": ["a"], "confidence": 0.5}
            if wanted in ("object", "loop", "date"):
                loop = []
                loop.append(loop)
                return {"object": object(), "loop": loop, "date": np.array(["2026"], "M8[D]")}[wanted]
            return [{"run": self.runs}]

        def get_action_batch(self, env_idx_list=None):
            return ["all"] if env_idx_list is None else list(env_idx_list)

        def reset(self):
            self.seen, self.events = [], []

        def prepare_case(self, case):
            return {"case": case["action_case_id"], "color": case.get("color")}

        def on_trial_end(self, result):
            return {"heard": sorted(result)}

        def declared(self, value=None):
            return value

        def report(self):
            ours = ("xpl_cli", "msgpack", "websockets", "yaml", "PIL")
            modules = sorted(name for name in sys.modules if name.split(".")[0] in ours)
            told = {"events": self.events, "color": self.color(), "modules": modules}
            return {"runs": self.runs, "pid": os.getpid(), **told}

        def color(self):
            cameras = self.seen[-1].get("vision") if self.seen else None
            return None if cameras is None else cameras["cam_head"]["color"]

        def undeclared(self):
            return "never reached"

        def _private(self):
            return "never reached"
"""

OBS = {"state": {"arm_joint_state": np.arange(7.0)}}


@pytest.fixture(scope="module")
def subject(write_adapter: Callable[..., Path]) -> Path:
    return write_adapter(SUBJECT, methods=["declared", "report", "_private"])


@pytest.fixture(scope="module")
def shared(subject: Path) -> Iterator[RunningServer]:
    """Serve it once for all tests that leave the server as it was."""
    with running_server(subject) as server:
        yield server


@pytest.fixture
def peer(shared: RunningServer) -> Iterator[Peer]:
    with greeted(shared.url) as connection:
        yield connection


def let_go(fifo: Path) -> None:
    """End the model's wait; returns when the model really waited."""
    with fifo.open("w"):
        pass


# -- every request has its answer --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_type", "payload"),
    [
        ("hello", {"evaluation_plan": {}, "capabilities": {"future": True}}),
        ("prepare_case", {"action_case_id": "c"}),
        ("reset", {"trial_id": "t", "task_name": "x", "seed": 3, "instruction": "y", "action_type": "joint"}),
        ("infer", {"observation": OBS}),
        ("call", {"func_name": "update_obs", "obs": OBS}),
        ("trial_end", {"trial_id": "t"}),
        ("heartbeat", {}),
    ],
)
def test_every_request_is_answered_by_its_type_and_with_its_identifiers(
    peer: Peer, request_type: str, payload: dict[str, Any]
) -> None:
    fields = {"action_case_id": "c", "trial_id": "t", "repeat_index": 4, "step": 9}
    peer.ask("reset")
    request = peer.send(request_type, payload, **fields)
    answer = peer.receive()
    assert answer.message_type == spec.ANSWERS[request_type]
    for name in ("message_id", "evaluation_id", *fields):
        assert getattr(answer, name) == getattr(request, name)
    assert request_type == "infer" or answer.payload["ok"] is True
    assert ("latency_ms" in answer.payload) == (request_type in {"infer", "call"})


def test_hello_tells_instance_and_capabilities(peer: Peer, shared: RunningServer) -> None:
    payload = peer.ask("hello").payload
    assert payload["server"].startswith("xpl ")
    assert isinstance(payload["capabilities"], dict)
    assert payload["server_instance_id"] == peer.ask("hello").payload["server_instance_id"]


def test_close_is_not_answered_and_closes(shared: RunningServer) -> None:
    connection = greeted(shared.url)
    connection.send("close")
    with pytest.raises(ConnectionClosed, match="1000"):
        connection.receive()


def test_hooks_are_called_with_the_payload(peer: Peer) -> None:
    assert peer.ask("prepare_case", {"action_case_id": "c7"}).payload["result"] == {"case": "c7", "color": None}
    assert peer.ask("trial_end", {"trial_id": "t", "success": True}).payload["result"] == {
        "heard": ["success", "trial_id"]
    }


def test_reset_infer_and_calls_reach_the_adapter(peer: Peer) -> None:
    peer.ask("reset")
    peer.ask("call", {"func_name": "update_obs", "obs": {"n": 1}})
    peer.ask("call", {"func_name": "get_action"})
    peer.ask("infer", {"observation": {"n": 2}})
    peer.ask("call", {"func_name": "get_action", "obs": {"n": 3}})
    events = peer.ask("call", {"func_name": "report"}).payload["result"]["events"]
    assert events == [["update_obs", 1], ["get_action", None], ["update_obs", 2], ["get_action", None],
                      ["update_obs", 3], ["get_action", None]]  # fmt: skip


def test_a_batch_call_passes_its_environments(peer: Peer) -> None:
    """Absent means None; an empty list stays one."""
    for obs, result in (([3, 1], [3, 1]), ([], []), (None, ["all"])):
        assert peer.ask("call", {"func_name": "get_action_batch", "obs": obs}).payload["result"] == result


def test_requests_in_flight_stay_in_order_even_if_one_has_images(peer: Peer) -> None:
    """Decoding takes time, and a request without images must not overtake."""
    picture = image_codec.encode_png(np.zeros((480, 640, 3), np.uint8))
    peer.ask("reset")
    for n in range(4):
        peer.send("call", {"func_name": "update_obs", "obs": {"n": n, "vision": {"cam_head": {"color": picture}}}})
        peer.send("call", {"func_name": "get_action"})
    events = peer.ask("call", {"func_name": "report"}).payload["result"]["events"]
    assert [n for kind, n in events if kind == "update_obs"] == [0, 1, 2, 3]
    assert [kind for kind, _ in events] == ["update_obs", "get_action"] * 4


def test_a_result_map_with_actions_passes_through(peer: Peer) -> None:
    payload = peer.ask("infer", {"observation": {"do": "map"}}).payload
    assert (payload["actions"], payload["confidence"]) == (["a"], 0.5)
    assert payload["latency_ms"] > 0


@pytest.mark.parametrize("name", ["infer", "update_obs", "update_obs_batch", "declared"])
@pytest.mark.parametrize("encode", [image_codec.encode_png, image_codec.encode_jpeg])
def test_images_arrive_decoded_in_every_request(peer: Peer, name: str, encode: Callable[..., bytes]) -> None:
    """Bytes or one-dimensional arrays; an adapter never decodes."""
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 255
    obs = {"vision": {"cam_head": {"color": np.frombuffer(encode(red), np.uint8)}}}
    peer.ask("reset")
    if name == "infer":
        answer = peer.ask("infer", {"observation": obs})
    else:
        answer = peer.ask("call", {"func_name": name, "obs": [obs] if name == "update_obs_batch" else obs})
    if name == "declared":
        arrived = answer.payload["result"]["vision"]["cam_head"]["color"]
    else:
        arrived = peer.ask("call", {"func_name": "report"}).payload["result"]["color"]
    assert np.abs(arrived.astype(int) - red).max() < 5


def test_every_kind_of_value_survives_the_way_to_the_adapter_and_back(peer: Peer) -> None:
    """Two codecs lie between; structures, scalars, odd keys and NaN are the same afterwards."""
    structure = np.zeros(2, [("a", "i1"), ("b", ">f4", (2,))])
    value = {
        "@array": 1, "nd": "x", "structure": structure, "scalar": np.float32(0.5), "flag": np.bool_(True),
        "empty": np.zeros((0, 3)), "zero_d": np.array(3), "bytes": b"\0\xff", "text": "é\0", "none": None,
        "complex": np.complex64(2j), "list": [[], {}, [None]], "big": np.arange(3, dtype=">i8"),
    }  # fmt: skip
    result = peer.ask("call", {"func_name": "declared", "obs": value}).payload["result"]
    assert result.keys() == value.keys()
    for key, sent in value.items():
        if isinstance(sent, (np.ndarray, np.generic)):
            assert (result[key].dtype, result[key].shape, result[key].tobytes()) == (
                sent.dtype,
                sent.shape,
                sent.tobytes(),
            )
            assert isinstance(result[key], np.ndarray) == isinstance(sent, np.ndarray)
        else:
            assert result[key] == sent


def test_the_worker_needs_nothing_but_numpy(peer: Peer) -> None:
    """None of the front end's libraries are loaded there, and not the tool."""
    assert peer.ask("call", {"func_name": "report"}).payload["result"]["modules"] == []


# -- what is refused, and how ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_type", "payload", "code", "message"),
    [
        ("dance", {}, "invalid_frame", "'dance' is not a request"),
        ("hello_ack", {}, "unknown_message_type", "'hello_ack' is not a request"),
        ("error", {}, "unknown_message_type", "'error' is not a request"),
        ("infer", {}, "invalid_frame", "observation"),
        ("infer", {"observation": [1]}, "invalid_frame", "observation"),
        ("infer", {"observation": {"vision": {"c": {"color": b"no image"}}}}, "invalid_frame", "do not decode"),
        ("infer", {"observation": {"do": "raise"}}, "infer_failed", "ValueError: the gripper is unhappy"),
        ("infer", {"observation": {"do": "exit"}}, "infer_failed", r"SystemExit: the adapter called sys.exit\(3\)"),
        ("infer", {"observation": {"do": "object"}}, "internal", "result cannot be sent.*object"),
        ("infer", {"observation": {"do": "loop"}}, "internal", "contains itself"),
        ("infer", {"observation": {"do": "date"}}, "internal", "only numbers, flags and text"),
        ("call", {}, "invalid_frame", "name of a public method"),
        ("call", {"func_name": "undeclared"}, "invalid_frame", "no method 'undeclared'.*declared"),
        ("call", {"func_name": "update_obs"}, "invalid_frame", "needs a payload with obs"),
        ("call", {"func_name": "update_obs", "obs": [1]}, "invalid_frame", "a map; got list"),
        ("call", {"func_name": "update_obs_batch"}, "invalid_frame", "needs a payload with obs"),
        ("call", {"func_name": "update_obs_batch", "obs": {}}, "invalid_frame", "a list; got dict"),
        ("call", {"func_name": "get_action_batch", "obs": 3}, "call_failed", "TypeError"),
        ("prepare_case", {}, "call_failed", "KeyError: 'action_case_id'"),
    ],
)
def test_errors_have_their_code_and_one_sentence(
    peer: Peer, request_type: str, payload: dict[str, Any], code: str, message: str
) -> None:
    """Never a traceback; and the server goes on."""
    answer = peer.ask(request_type, payload)
    assert answer.message_type == "error"
    assert answer.payload["code"] == code
    assert re.search(message, answer.payload["message"]), answer.payload["message"]
    assert "Traceback" not in answer.payload["message"]
    assert answer.payload["details"] == {}
    assert peer.ask("call", {"func_name": "report"}).message_type == "call_result"


def test_a_frame_that_cannot_be_decoded_is_answered_if_its_id_can_be_read(peer: Peer) -> None:
    """With the identifiers that are right; anything else is dropped, and the connection lives."""
    fields = vars(
        codec.Frame("infer", "e", {"observation": {b"nd": True, b"type": "|O", b"data": b""}}, message_id="m", step=4)
    )
    for noise in (b"", b"\xc1", msgpack.packb([1]), msgpack.packb({"message_id": 4})):
        peer.socket.send(noise)
    peer.socket.send("text")
    peer.socket.send(msgpack.packb(fields))
    answer = peer.receive()
    assert (answer.message_type, answer.message_id, answer.evaluation_id, answer.step) == ("error", "m", "e", 4)
    assert answer.payload["code"] == "invalid_frame"
    assert peer.ask("heartbeat").message_type == "heartbeat_ack"


def test_output_of_the_adapter_goes_to_the_log_and_nowhere_else(peer: Peer, shared: RunningServer) -> None:
    assert peer.ask("infer", {"observation": {"do": "print"}}).message_type == "infer_result"
    wait_until(lambda: any("raw bytes" in line for line in shared.log), "the output arrived")
    assert "the model prints while it loads" in shared.log
    peer.ask("infer", {"observation": {"do": "raise"}})
    wait_until(
        lambda: any("ValueError: the gripper is unhappy" in line for line in shared.log), "the traceback arrived"
    )
    assert any("Traceback" in line for line in shared.log)


# -- exactly once ------------------------------------------------------------------------------------------------------


def runs(peer: Peer) -> int:
    return int(peer.ask("call", {"func_name": "report"}).payload["result"]["runs"])


def test_a_repeated_id_is_answered_and_runs_nothing(peer: Peer) -> None:
    before = runs(peer)
    first = peer.ask("infer", {"observation": OBS}, message_id="repeated")
    assert runs(peer) == before + 1
    again = peer.ask("infer", {"observation": OBS}, message_id="repeated")
    assert again.payload["actions"] == first.payload["actions"]
    failed = peer.ask("infer", {"observation": {"do": "raise"}}, message_id="failed")
    assert peer.ask("infer", {"observation": OBS}, message_id="failed").payload == failed.payload
    assert runs(peer) == before + 2


def test_a_repeated_id_joins_the_request_that_runs(peer: Peer, fifo: Path) -> None:
    before = runs(peer)
    for _ in range(3):
        peer.send("infer", {"observation": {"do": "wait", "fifo": str(fifo)}}, message_id="joined")
    let_go(fifo)
    answers = [peer.receive() for _ in range(3)]
    assert {answer.message_id for answer in answers} == {"joined"}
    assert all(answer.payload["actions"] == [{"run": before + 1}] for answer in answers)
    assert runs(peer) == before + 1


def test_a_retry_after_a_cut_gets_the_answer_of_the_one_run(shared: RunningServer, fifo: Path) -> None:
    """The cut comes while the model thinks; the retry comes over a new connection."""
    peer = greeted(shared.url)
    before = runs(peer)
    payload = {"observation": {"do": "wait", "fifo": str(fifo)}}
    peer.send("infer", payload, message_id="cut")
    with fifo.open("w"):
        peer.cut()
        back = greeted(shared.url, peer.evaluation_id)
        back.send("infer", payload, message_id="cut")
    with back:
        assert back.receive().payload["actions"] == [{"run": before + 1}]
        assert runs(back) == before + 1


# -- who may use the worker --------------------------------------------------------------------------------------------


def test_heartbeats_are_answered_while_the_model_thinks(peer: Peer, fifo: Path) -> None:
    """To the client that waits, and to others."""
    request = peer.send("infer", {"observation": {"do": "wait", "fifo": str(fifo)}})
    with fifo.open("w"):  # opened when the model waits
        assert peer.ask("heartbeat").message_type == "heartbeat_ack"
    assert peer.receive().message_id == request.message_id


@pytest.mark.parametrize("goodbye", [True, False], ids=["a goodbye", "a close in order"])
def test_a_second_client_is_busy_at_hello_until_the_first_one_leaves(shared: RunningServer, goodbye: bool) -> None:
    """Then it is let in; it may try on the same connection. Clients of the field just close."""
    first = greeted(shared.url)
    with Peer(shared.url) as second:
        refusal = second.ask("hello")
        assert (refusal.message_type, refusal.payload["code"]) == ("error", "internal")
        assert refusal.payload["details"] == {"reason": "busy"}
        assert second.ask("infer", {"observation": OBS}).payload["details"] == {"reason": "busy"}
        assert second.ask("heartbeat").message_type == "heartbeat_ack"
        if goodbye:
            first.send("close")
        first.close()
        wait_until(lambda: second.ask("hello").message_type == "hello_ack", "the lease is free")


def test_a_cut_client_keeps_its_lease_for_the_grace_period(shared: RunningServer) -> None:
    """Others hear busy; its own evaluation comes back to its own state."""
    first = greeted(shared.url)
    first.ask("reset")
    first.ask("call", {"func_name": "update_obs", "obs": {"n": 42}})
    first.cut()
    with Peer(shared.url) as other:
        assert other.ask("hello").payload["details"] == {"reason": "busy"}
    with greeted(shared.url, first.evaluation_id) as back:
        assert back.ask("call", {"func_name": "report"}).payload["result"]["events"] == [["update_obs", 42]]


# -- loading -----------------------------------------------------------------------------------------------------------


def test_an_adapter_with_infer_alone_and_no_hooks_is_served(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    """The hooks are optional; the missing operations are named."""
    model = "class Model:\n    def __init__(self, config): pass\n    def infer(self, observation): return [1]"
    with Peer(serve(write_adapter(model)).url) as peer:
        assert peer.ask("infer", {"observation": {}}).payload["actions"] == [1]
        for kind in ("prepare_case", "trial_end"):
            assert peer.ask(kind, {"action_case_id": "c"}).payload == {"ok": True}
        assert "no method 'reset'" in peer.ask("reset").payload["message"]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("model", "reason"),
    [
        ("raise ValueError('no weights')", "the model could not be loaded: ValueError: no weights"),
        ("import sys; sys.exit(7)", r"SystemExit: the adapter called sys\.exit\(7\)"),
        ("import os; os._exit(7)", "the worker ended with exit code 7"),
        ("import os; os.kill(os.getpid(), 11)", "the worker was ended by signal SIGSEGV"),
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("class Policy: pass", "LoadError: .*model.py defines no class Model"),
        ("Model = 3", "defines no class Model"),
        ("class Model(", "SyntaxError"),
        ("class Model:\n    pass", r"TypeError: Model\(\) takes no arguments"),
    ],
)
def test_a_model_that_cannot_be_loaded_ends_the_server_with_one_sentence(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer], model: str, reason: str
) -> None:
    """Which names the policy; the traceback is in the log."""
    with pytest.raises(ServerStartError) as failure:
        serve(write_adapter(model))
    assert failure.value.code == ExitCode.NOT_RUN
    assert failure.value.reason.startswith("Subject: ")
    assert "\n" not in failure.value.reason
    assert re.search(reason, failure.value.reason)


def test_a_configuration_that_cannot_travel_is_one_sentence(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer]
) -> None:
    """YAML has dates, and the link has none."""
    folder = write_adapter(SUBJECT)
    (folder / "deploy.yml").write_text("env_cfg_type: piper\nrelease: 2026-01-01\n", encoding="utf-8")
    with pytest.raises(ServerStartError, match=r"datetime\.date cannot be sent"):
        serve(folder)


# -- ends --------------------------------------------------------------------------------------------------------------


ORPHANS = """
    import subprocess, sys


    class Model:
        def __init__(self, config):
            self.child = subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"])

        def infer(self, observation):
            open(observation["fifo"]).read()
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("number", "thinking"),
    [(signal.SIGKILL, True), (signal.SIGKILL, False), (signal.SIGINT, True), (signal.SIGTERM, False)],
)
def test_no_signal_leaves_a_process_behind(
    write_adapter: Callable[..., Path], fifo: Path, number: signal.Signals, thinking: bool
) -> None:
    """Neither the worker, nor what the model started, even if the front end has no time to clean up."""
    mark = uuid.uuid4().hex
    process = subprocess.Popen(
        [sys.executable, "-m", "xpl_cli", "serve", str(write_adapter(ORPHANS)), "--port", "0"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env={**os.environ, MARK: mark}, start_new_session=True,
    )  # fmt: skip
    assert process.stdout is not None
    try:
        url = json.loads(process.stdout.readline())["url"]
        wait_until(lambda: len(processes(mark)) == 4, "front end, reaper, worker and the model's child run")
        peer = Peer(url)
        with contextlib.ExitStack() as stack:
            if thinking:
                peer.send("infer", {"observation": {"fifo": str(fifo)}})
                stack.enter_context(fifo.open("w"))
            process.send_signal(number)
            assert process.wait(DEADLINE_S) == (-9 if number == signal.SIGKILL else 0)
            wait_until(lambda: not processes(mark), "all processes are gone")
        with contextlib.suppress(Exception):
            peer.close()
    finally:
        process.stdout.close()
        for pid in processes(mark):
            os.kill(pid, signal.SIGKILL)


# -- the interpreter ---------------------------------------------------------------------------------------------------


def test_an_adapter_is_served_in_the_oldest_supported_python(
    write_adapter: Callable[..., Path], serve: Callable[..., RunningServer], old_python: str
) -> None:
    model = """
        import sys
        import numpy as np
        from xpl import Policy

        class Model(Policy):
            def encode(self, obs, env): return obs["n"]
            def predict(self, inputs, envs): return np.full((len(envs), 2, 8), sys.version_info[1] / 10)
    """
    with Client(serve(write_adapter(model), python=old_python).url) as client:
        client.reset()
        assert client.infer({"n": 1})[0]["ee_joint_state"].tolist() == pytest.approx([0.9])
