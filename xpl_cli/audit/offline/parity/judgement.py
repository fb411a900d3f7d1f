"""Whether an adapter's answers equal the golden ones: for each number of the action, as a share of the golden span.

A difference counts if it exceeds the tolerance and the difference between two recordings of the reference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from xpl_cli.model_io.difference import differences, spreads

if TYPE_CHECKING:
    from xpl_cli.model_io.pairs import Chunk, PairQuestion, PairSession

_ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Share of a number that its float32 may be off by, on both sides."""


@dataclass(frozen=True)
class Deviation:
    """The worst number of a session's answers, where it differs first.

    Attributes:
        part: the number, such as left_ee_joint_state[0].
        question, step: the first question and step in which it differs.
        golden, answer: the two values there.
        share: largest difference, as a share of the span.
        span: of the golden answers.
        allowed: share that is allowed.
        parts: all numbers that differ, the farthest first.
        pairs: how many questions have a number that differs.
    """

    part: str
    question: PairQuestion
    step: int
    golden: float
    answer: float
    share: float
    span: float
    allowed: float
    parts: tuple[str, ...]
    pairs: int


@dataclass(frozen=True)
class Judgement:
    """Comparison of an adapter's answers with the golden ones of a session.

    Args:
        session: the golden ones.
        answers: the adapter's chunk of each question.
        share: of the span that is allowed.
        noise: by key, what two recordings of the golden answers are apart.
    """

    session: PairSession
    answers: Sequence[Chunk]
    share: float
    noise: Mapping[str, float]

    @cached_property
    def golden(self) -> list[Chunk]:
        """The golden chunks, cut to the length of the adapter's, which may hand on only the beginning."""
        chunks = [self.session.chunk(question) for question in self.session.questions]
        return [chunk[: len(other)] for chunk, other in zip(chunks, self.answers, strict=True)]

    @cached_property
    def spread(self) -> dict[str, float]:
        """By number, the span of the golden answers that its differences are measured by."""
        return spreads(self.golden)

    @cached_property
    def allowed(self) -> dict[str, float]:
        """By number, the share of the span that is allowed."""
        largest: dict[str, float] = {}
        for chunk in self.golden:
            for step in chunk:
                for key, values in step.items():
                    largest[key] = max(largest.get(key, 0.0), float(np.abs(values).max()))
        allowed = {}
        for part, span in self.spread.items():
            key = part.partition("[")[0]
            allowed[part] = self.share + (2 * self.noise.get(key, 0.0) + _ROUNDING * largest[key]) / span
        return allowed

    @property
    def tolerance(self) -> float:
        """The largest share that is allowed of any number."""
        return max(self.allowed.values(), default=self.share)

    @cached_property
    def shares(self) -> dict[str, float]:
        """By number, how far the adapter's answers are from the golden ones."""
        return differences(self.golden, self.answers, self.spread)

    @cached_property
    def differs(self) -> list[bool]:
        """For each question, whether a number of its answer differs."""
        return [self.differ(*chunks) for chunks in zip(self.golden, self.answers, strict=True)]

    def differ(self, one: Chunk, other: Chunk) -> bool:
        """Whether a number of two answers to a question differs."""
        shares = differences([one], [other], self.spread)
        return any(share > self.allowed[part] for part, share in shares.items())

    @property
    def deviation(self) -> Deviation | None:
        """What differs most, None if nothing does."""
        parts = sorted(
            (part for part, share in self.shares.items() if share > self.allowed[part]),
            key=lambda part: -self.shares[part],
        )
        if not parts:
            return None
        part = parts[0]
        number, step = self._first(part)
        key, _, rest = part.partition("[")
        index = int(rest[:-1])
        chunk, other = self.golden[number], self.answers[number]
        is_in_both = step < min(len(chunk), len(other))
        return Deviation(
            part=part,
            question=self.session.questions[number],
            step=step,
            golden=float(chunk[step][key][index]) if is_in_both else float("nan"),
            answer=float(other[step][key][index]) if is_in_both else float("nan"),
            share=self.shares[part],
            span=self.spread[part],
            allowed=self.allowed[part],
            parts=tuple(parts),
            pairs=sum(self.differs),
        )

    def _first(self, part: str) -> tuple[int, int]:
        """Return the first question and step in which a number differs."""
        for number, (chunk, other) in enumerate(zip(self.golden, self.answers, strict=True)):
            for step, (one, two) in enumerate(zip(chunk, other, strict=False)):
                if differences([[one]], [[two]], self.spread)[part] > self.allowed[part]:
                    return number, step
        return 0, 0
