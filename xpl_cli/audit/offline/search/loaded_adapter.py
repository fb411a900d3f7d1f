"""An adapter in a process of its own interpreter, which loads the model once and answers under many mistakes.

Mistakes are other values of its model_io block, or changes of the inputs that its `encode` returns.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from xpl_cli.audit.offline import inprocess
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.isolation import subprocess_task

if TYPE_CHECKING:
    from xpl.catalogue import Mistake
    from xpl.contract import Entry
    from xpl_cli.audit.offline.search.session_replay import SessionReplay
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.pairs import Chunk

AnswersByQuestion = Mapping[int, "Sequence[Any]"]
"""Action steps by question number; None for steps that are not known."""

_MORE_S = 30.0
"""Seconds added to the limit of a request before the process is ended."""


@dataclass(frozen=True)
class MistakeAnswers:
    """The answers of an adapter with a mistake undone.

    Attributes:
        words, convention: of the mistake, refined by the process where it knows better.
        answers: by question; None where the mistake does not apply.
    """

    words: str
    convention: str
    answers: AnswersByQuestion | None


@dataclass(frozen=True)
class _WorkerAnswer:
    """The reply of `xpl.worker.encoded.play` to a change; empty where the change does not apply.

    Attributes:
        answers: of each question.
        words, convention: what the change is, if the process knows better.
        apart: how far pictures are from those before.
        draws: how many times something was drawn.
    """

    answers: Sequence[Chunk] | None = None
    words: str | None = None
    convention: str | None = None
    apart: float = 0.0
    draws: int | None = None

    @classmethod
    def read(cls, entry: Entry | None) -> Self:
        if entry is None:
            return cls()
        return cls(
            entry["answers"], entry.get("words"), entry.get("convention"), entry.get("apart", 0.0), entry.get("draws")
        )


class LoadedAdapter:
    """One adapter and the session that it replays. The process starts with the first request.

    Args:
        probe: the adapter.
        replay: the questions.
        config: values of deploy.yml after overrides.
        block: its model_io block, as it is used; empty without one.
    """

    def __init__(self, probe: Probe, replay: SessionReplay, config: Mapping[str, object], block: Entry) -> None:
        self._probe, self._replay, self._config, self._block = probe, replay, config, block
        self._nearest: set[str] = set()
        self._standing: subprocess_task.PersistentTask | None = None
        self._sent: set[str] = set()
        self.draws: int | None = None
        """How many times numbers are drawn in some answers; None if that is not known."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._standing is not None:
            self._standing.close()
            self._standing = None

    def answers_by_block(
        self, blocks: Sequence[Entry], questions: Sequence[int], seconds: float
    ) -> list[AnswersByQuestion | None] | None:
        """Return the answers to some questions under each model_io block, until the time is over.

        Args:
            blocks: what is tried.
            questions: numbers of questions.
            seconds: how long it may take.

        Returns:
            None for a block that cannot be used; None in all if the block does not say how the adapter converts, or the
            model cannot be loaded there.
        """
        results = self._request({"blocks": list(blocks)}, questions, seconds)
        return results and [None if answers is None else self._by_number(answers, questions) for answers in results]

    def answers_by_input_change(
        self, changes: Sequence[Mistake], questions: Sequence[int], seconds: float
    ) -> list[MistakeAnswers]:
        """Return the answers to some questions under each change of encoded inputs, until the time is over.

        Empty if the adapter does not derive from `xpl.Policy`, or cannot be loaded there. For images of another size,
        the process returns their distance from the adapter's own: the nearest geometry is the adapter's, and a change
        that keeps the geometry changes the resize filter.
        """
        results = self._request({"changes": [dict(one.input_change or {}) for one in changes]}, questions, seconds)
        tried = list(zip(changes, map(_WorkerAnswer.read, results or []), strict=False))
        sizes = [(result.apart, change.geometry) for change, result in tried if result.answers and change.geometry]
        least = min(sizes, default=(0.0, ""))[0]
        # Of the first, which were all; with some pictures several geometries are one.
        self._nearest = self._nearest or {geometry for apart, geometry in sizes if apart <= least}
        self.draws = next((result.draws for _, result in tried if result.draws is not None), self.draws)
        return [
            MistakeAnswers(
                change.description if result.words is None else result.words,
                _convention_of(change, self._nearest) if result.convention is None else result.convention,
                self._by_number(result.answers, questions) if result.answers else None,
            )
            for change, result in tried
        ]

    def _by_number(self, answers: Sequence[Chunk], questions: Sequence[int]) -> AnswersByQuestion:
        return dict(zip(self._replay.with_earlier(questions), answers, strict=True))

    def _request(self, request: Mapping[str, object], questions: Sequence[int], seconds: float) -> list[Any] | None:
        """Return what the process says of each change, None for one that has no meaning here.

        None in all if the adapter cannot be asked so, or the model cannot be loaded there.
        """
        standing = self._standing or self._start_process(seconds)
        if standing is None:
            return None
        self._standing = standing
        order = {
            **request,
            **self._replay.worker_request(self._replay.calls_for(questions), self._sent),
            "seconds": seconds,
        }
        done = standing.request(order, seconds + _MORE_S)
        if done.problem is not None or not done.answers:  # the next order begins with a new process
            self.__exit__()
        if not done.answers or done.answers[0].result is not None:
            return None
        return [answer.result for answer in done.answers[1:]]

    def _start_process(self, seconds: float) -> subprocess_task.PersistentTask | None:
        self._sent.clear()
        order = {**inprocess.load_request(self._probe), "config": self._config, "block": dict(self._block)}
        standing = subprocess_task.PersistentTask(
            "xpl.worker.perturbed_answers", order, inprocess.process_options(self._probe, seconds + _MORE_S)
        )
        try:
            inprocess.answers_after_load(standing.loaded)
        except NotRun:
            standing.close()
            return None
        return standing


def _convention_of(change: Mistake, nearest: Collection[str]) -> str:
    return "image_filter" if change.geometry and change.geometry in nearest else change.convention
