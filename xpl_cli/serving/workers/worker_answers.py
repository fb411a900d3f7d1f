"""Parse the answers of a worker, which may hold anything: an adapter can write to the link itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from xpl.process.link import Head


class WorkerAnswerError(ValueError):
    """A malformed answer; the message says what was expected and what came."""


RAISED_AT = "raised_at"
"""Key of the frames of the adapter's own files; only an audit's own servers pass them on."""
Frame = tuple[str, int, str]
"""A frame of a traceback: file relative to the adapter's folder, line, and name of the function."""


@dataclass(frozen=True)
class AdapterException:
    """An exception in a worker (`xpl.worker.main`).

    Attributes:
        kind: its type.
        message: one sentence.
        traceback: with it as the last line.
        lacks: what the machine lacks, if that is why: `kind` and `name`.
        refused: the request itself was wrong.
        unserialisable: the result cannot be serialised.
        raised_at: frames of the adapter's own files, innermost first: file, line and function.
    """

    kind: str
    message: str
    traceback: str
    lacks: Mapping[str, str] | None
    refused: bool
    unserialisable: bool
    raised_at: tuple[Frame, ...] = ()

    @classmethod
    def parse(cls, value: object) -> Self:
        """Parse the error entry of a worker's answer.

        Raises:
            HeadError: if it is no such map.
        """
        entries = _require_map(value, "an error")
        kind, message, traceback = (_require_text(entries.get(name), name) for name in ("type", "message", "traceback"))
        lacks = entries.get("lacks")
        if lacks is not None:
            lacks = {name: _require_text(_require_map(lacks, "lacks").get(name), name) for name in ("kind", "name")}
        flags = entries.get("refused") is True, entries.get("unserialisable") is True
        return cls(kind, message, traceback, lacks, *flags, parse_frames(entries.get(RAISED_AT)))


def parse_frames(value: object) -> tuple[Frame, ...]:
    """Return the frames in a message; those that are none are left out."""
    frames = value if isinstance(value, (list, tuple)) else ()
    return tuple(
        (frame[0], frame[1], frame[2])
        for frame in frames
        if isinstance(frame, (list, tuple)) and [type(part) for part in frame] == [str, int, str]
    )


def parse_result(head: Head) -> Head | AdapterException | None:
    """Return the result of a control message, or its exception.

    Raises:
        WorkerAnswerError: the head has neither.
    """
    if "error" in head:
        return AdapterException.parse(head["error"])
    if "ok" not in head:
        raise WorkerAnswerError(f"expected ok or error, got {sorted(head)!r:.80}")
    return None if head["ok"] is None else _require_map(head["ok"], "ok")


def parse_answers(head: Head, results: Sequence[memoryview], count: int) -> list[memoryview | AdapterException]:
    """Return the result or the exception of each request of a batch.

    Args:
        head: `answers`: for each request None, or its error.
        results: those of the successful requests, in order.
        count: number of requests.

    Raises:
        HeadError: if their number or form is wrong.
    """
    entries = head.get("answers")
    if not isinstance(entries, list) or len(entries) != count or entries.count(None) != len(results):
        got = f"{len(entries)} and" if isinstance(entries, list) else f"a {type(entries).__name__} and"
        raise WorkerAnswerError(
            f"expected {count} answers and the results of those that raised nothing, got {got} {len(results)}"
        )
    result = iter(results)
    return [next(result) if one is None else AdapterException.parse(one) for one in entries]


def _require_map(value: object, what: str) -> Head:
    if not isinstance(value, dict):
        raise WorkerAnswerError(f"expected {what} to be a map, got {type(value).__name__}")
    return value


def _require_text(value: object, name: str) -> str:
    if not isinstance(value, str):
        raise WorkerAnswerError(f"expected {name} to be text, got {type(value).__name__}")
    return value
