"""Differences between a new recording of golden pairs and the existing one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from xpl_cli.model_io.difference import differences, spreads
from xpl_cli.model_io.explain import format_parts

if TYPE_CHECKING:
    from xpl_cli.model_io.pairs import GoldenPairs, PairSession

_SAME = 1e-6
"""Share of the span below which a number is rounded otherwise, and not another one."""


def describe_changes(before: GoldenPairs, after: GoldenPairs) -> Iterator[str]:
    """Yield a sentence for each robot and action type that differs; nothing if all answers are equal."""
    earlier = {(one.embodiment, one.action_type): one for one in before.sessions}
    for session in after.sessions:
        name = f"{session.embodiment} {session.action_type}"
        old = earlier.pop((session.embodiment, session.action_type), None)
        if old is None:
            yield f"{name}: {len(session.questions)} pairs are new"
        elif (old.calls, old.cameras, old.takes) != (session.calls, session.cameras, session.takes):
            yield f"{name}: the questions differ, {len(session.questions)} instead of {len(old.questions)}"
        else:
            yield from _answers(name, old, session)
    for name in (" ".join(key) for key in earlier):
        yield f"{name}: its pairs are gone"


def _answers(name: str, old: PairSession, new: PairSession) -> Iterator[str]:
    before = [old.chunk(question, take) for question in old.questions for take in range(old.takes)]
    after = [new.chunk(question, take) for question in new.questions for take in range(new.takes)]
    if [len(chunk) for chunk in before] != [len(chunk) for chunk in after]:
        yield f"{name}: answers have another number of steps"
        return
    span = spreads(before)
    shares = differences(before, after, span)
    differing = sorted((part for part, share in shares.items() if share > _SAME), key=lambda part: -shares[part])
    if differing:
        by_answer = [differences([one], [other], span) for one, other in zip(before, after, strict=True)]
        count = sum(any(share > _SAME for share in answer_shares.values()) for answer_shares in by_answer)
        most = shares[differing[0]]
        distance = f"{most:.2g} of its span" if np.isfinite(most) else "beyond its span"
        parts = format_parts(differing)
        yield f"{name}: {count} of {len(before)} answers differ, {differing[0]} by {distance}; in {parts}"
