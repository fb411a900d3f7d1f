from __future__ import annotations

import pytest

from xpl import _spec as spec
from xpl.wire import codec, packed
from xpl_cli.serving import requests
from xpl_cli.serving.requests import ReplayCache, RequestError

# -- what a frame asks for ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "payload", "method", "optional", "failure"),
    [
        ("infer", {}, "infer", False, "infer_failed"),
        ("reset", {"trial_id": "t"}, "reset", False, "reset_failed"),
        ("prepare_case", {}, "prepare_case", True, "call_failed"),
        ("trial_end", {}, "on_trial_end", True, "call_failed"),
        ("call", {"func_name": "update_obs"}, "update_obs", False, "call_failed"),
        ("call", {"func_name": "prepare_case"}, "prepare_case", False, "call_failed"),
        ("call", {"func_name": "declared"}, "declared", False, "call_failed"),
    ],
)
def test_a_frame_names_the_method_that_it_is_about(
    kind: str, payload: dict[str, str], method: str, optional: bool, failure: str
) -> None:
    """Hooks are optional where the wire has a frame for them, and a method like any other where they are called."""
    frame = codec.Frame(kind, "e", payload)
    assert requests.method_of(frame) == method
    assert requests.is_optional(frame) is optional
    assert requests.failure_code(frame) == failure


@pytest.mark.parametrize("name", [None, 3, [], "_private", "__init__", "infer", "reset_envs"])
def test_what_may_not_be_called_by_name_is_refused(name: object) -> None:
    """Also what would reset the environments of other clients."""
    with pytest.raises(RequestError, match="call needs the name of a public method") as refused:
        requests.method_of(codec.Frame("call", "e", {"func_name": name}))
    assert refused.value.payload()["code"] == spec.ErrorCode.INVALID_FRAME


def test_an_error_frame_says_what_went_wrong() -> None:
    """A word for the program, a sentence for people, and what else there is to know."""
    assert RequestError("internal", "in use").payload() == {"code": "internal", "message": "in use", "details": {}}
    detailed = RequestError("internal", "in use", "busy", places=3).payload()
    assert detailed["details"] == {"reason": "busy", "places": 3}


def test_packed_entries_pass_unread() -> None:
    data = b"".join(packed.encode({"obs": 1}))
    assert requests.packed_payload(codec.Frame("call", "e", {"packed": data})) == data
    assert requests.packed_payload(codec.Frame("call", "e", {"obs": 1})) is None


def test_damaged_packed_entries_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before a worker sees them; so is a header that would take long to read."""
    data = b"".join(packed.encode({"obs": [1] * 100}))
    for damaged in (b"", data[:-1], data + b"0", b"XPL2" + data[4:], "text", 3):
        with pytest.raises(RequestError) as refused:
            requests.packed_payload(codec.Frame("call", "e", {"packed": damaged}))
        assert refused.value.code == spec.ErrorCode.INVALID_FRAME
    monkeypatch.setitem(spec.LIMITS, "packed_header", 100)
    with pytest.raises(RequestError, match="send long lists and texts unpacked"):
        requests.packed_payload(codec.Frame("call", "e", {"packed": data}))


# -- answers that are remembered ---------------------------------------------------------------------------------------


def finished(replay: ReplayCache, answer: bytes = b"x" * 10) -> codec.Frame:
    """Return a request that was begun and answered."""
    frame = codec.Frame("infer", "e")
    replay.finish(frame.message_id, replay.begin(frame), answer)
    return frame


def test_all_who_wait_for_an_answer_are_told_once() -> None:
    """A repeated request joins the one that runs; later it finds the answer."""
    replay, told = ReplayCache(), list[bytes]()
    frame = codec.Frame("infer", "e")
    assert replay.find(frame) is None
    entry = replay.begin(frame)
    entry.waiting.append(told.append)
    assert replay.find(frame) is entry
    entry.waiting.append(told.append)
    assert entry.answer is None
    replay.finish(frame.message_id, entry, b"answer")
    assert told == [b"answer"] * 2
    assert entry.waiting == []
    found = replay.find(frame)
    assert found is not None
    assert found.answer == b"answer"


def test_an_id_belongs_to_one_type_of_request() -> None:
    """Another type under the same id is a mistake of the client."""
    replay = ReplayCache()
    frame = finished(replay)
    with pytest.raises(RequestError, match="was used for infer and for call") as refused:
        replay.find(codec.Frame("call", "e", message_id=frame.message_id))
    assert refused.value.reason == spec.ErrorReason.DUPLICATE_ID


def test_the_memory_of_answers_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """By entries and by bytes: the oldest go."""
    monkeypatch.setitem(spec.LIMITS, "replay_entries", 3)
    monkeypatch.setitem(spec.LIMITS, "replay_bytes", 100)
    replay = ReplayCache()
    frames = [finished(replay) for _ in range(6)]
    assert [replay.find(frame) is None for frame in frames] == [True, True, True, False, False, False]
    assert (len(replay), replay.size) == (3, 30)
    large = finished(replay, b"x" * 99)
    assert replay.find(large) is not None
    assert (len(replay), replay.size) == (1, 99)


def test_the_newest_answer_is_kept_whatever_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is the one that is asked for again after a cut; others may run meanwhile."""
    monkeypatch.setitem(spec.LIMITS, "replay_bytes", 100)
    replay = ReplayCache()
    running = replay.begin(codec.Frame("infer", "e"))
    frame = finished(replay, b"x" * 1000)
    later = replay.begin(codec.Frame("infer", "e"))
    assert replay.find(frame) is not None
    assert finished(replay) is not None
    assert replay.find(frame) is None
    assert (len(replay), replay.size) == (3, 10)
    assert running.answer is later.answer is None


def test_what_still_runs_is_never_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """And does not keep others: one slow request is no reason to remember everything after it."""
    monkeypatch.setitem(spec.LIMITS, "replay_entries", 3)
    replay = ReplayCache()
    slow = [codec.Frame("infer", "e") for _ in range(4)]
    entries = [replay.begin(frame) for frame in slow]
    frames = [finished(replay) for _ in range(5)]
    assert [replay.find(frame) is None for frame in frames] == [True] * 4 + [False]
    assert [replay.find(frame) for frame in slow] == entries
    for frame, entry in zip(slow, entries, strict=True):
        replay.finish(frame.message_id, entry, b"x" * 10)
    assert (len(replay), replay.size) == (3, 30)


def test_another_client_finds_nothing() -> None:
    """Even if the worker is still busy for the last one; that answer is told, and not remembered."""
    replay, told = ReplayCache(), list[bytes]()
    finished(replay)
    old = codec.Frame("infer", "e", message_id="1")
    entry = replay.begin(old)
    entry.waiting.append(told.append)
    replay.clear()
    assert (len(replay), replay.size) == (0, 0)
    new = codec.Frame("infer", "f", message_id="1")
    assert replay.find(new) is None
    own = replay.begin(new)
    replay.finish("1", entry, b"late")
    assert told == [b"late"]
    assert own.answer is None
    assert replay.size == 0
    replay.finish("1", own, b"new")
    assert replay.size == 3
