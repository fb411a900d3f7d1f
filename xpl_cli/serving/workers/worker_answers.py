"""What a worker answers, parsed where it comes in: an adapter may write to the link itself, and write anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from xpl.process.link import Head


class WorkerAnswerError(ValueError):
    """An answer that is none of those that were agreed on; says what was expected and what came."""


@dataclass(frozen=True)
class AdapterException:
    """What a worker says of an exception (`xpl.worker.main`).

    Attributes:
        kind: its type.
        message: one sentence.
        traceback: with it as the last line.
        lacks: what the machine lacks, if that is why: `kind` and `name`.
        refused: the request itself was wrong.
        unserialisable: it is the result that cannot travel.
    """

    kind: str
    message: str
    traceback: str
    lacks: Mapping[str, str] | None
    refused: bool
    unserialisable: bool

    @classmethod
    def parse(cls, value: object) -> Self:
        """Read it from a worker's answer.

        Raises:
            HeadError: it is no such map.
        """
        entries = _require_map(value, "an error")
        kind, message, traceback = (_require_text(entries.get(name), name) for name in ("type", "message", "traceback"))
        lacks = entries.get("lacks")
        if lacks is not None:
            lacks = {name: _require_text(_require_map(lacks, "lacks").get(name), name) for name in ("kind", "name")}
        flags = entries.get("refused") is True, entries.get("unserialisable") is True
        return cls(kind, message, traceback, lacks, *flags)


def parse_result(head: Head) -> Head | AdapterException | None:
    """Return what an operation that is no request returned, or what it raised.

    Raises:
        HeadError: the head says neither.
    """
    if "error" in head:
        return AdapterException.parse(head["error"])
    if "ok" not in head:
        raise WorkerAnswerError(f"expected ok or error, got {sorted(head)!r:.80}")
    return None if head["ok"] is None else _require_map(head["ok"], "ok")


def parse_answers(head: Head, results: Sequence[memoryview], count: int) -> list[memoryview | AdapterException]:
    """Return what each of so many requests got.

    Args:
        head: `answers`: for each request None, or what it raised.
        results: of those that raised nothing, in order.
        count: of the requests.

    Raises:
        HeadError: they are not as many, or something else.
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
