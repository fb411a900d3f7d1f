"""Patterns of differences that no single change explains: which answers are wrong, and which are right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl_cli.model_io.difference import columns, differences
from xpl_cli.packages.conventions import HISTORY

if TYPE_CHECKING:
    from xpl_cli.model_io.difference import Differences, EpisodeAnswers

_SAME = 1e-6
"""Share of the span below which steps are the same."""
_FEW = 0.25
"""Share of the later answers that may be right by chance, where a model remembers."""
_MANY = 4
"""Answers of which one is hardly the only right one by chance."""
_SIGMAS = 4.0
"""How far the mean of differences may be from zero, in its standard errors, where they are drawn."""


@dataclass(frozen=True)
class Pattern:
    """One pattern.

    Attributes:
        words: the observation, and what it suggests.
        convention: of the vocabulary, that it suggests.
        others: conventions that it suggests as well.
    """

    words: str
    convention: str
    others: tuple[str, ...] = ()

    @property
    def conventions(self) -> tuple[str, ...]:
        """All that it suggests."""
        return (self.convention, *self.others)


@dataclass(frozen=True)
class PolicyKind:
    """The kind of policy.

    Attributes:
        keeps_state: whether it is recurrent.
        history: observations that it sees.
        draws: whether it samples.
    """

    keeps_state: bool = False
    history: int = 1
    draws: bool = False


def patterns(
    episodes: Sequence[EpisodeAnswers], spread: Differences, tolerance: float, kind: PolicyKind
) -> Iterator[Pattern]:
    """Yield patterns, the most informative first.

    Args:
        episodes: all episodes, in their order; something differs.
        spread: of `difference.spreads`.
        tolerance: largest share of it that is no difference.
        kind: of policy.
    """
    if _is_constant(episodes, spread):
        yield Pattern("every step of a chunk is the same, and the model's are not", "chunk")
    yield from _memory(episodes, spread, tolerance, kind)
    yield from _steps(episodes, spread, tolerance)
    if kind.draws and _is_drawn(episodes, spread):
        yield Pattern(
            "differences are random about zero: other numbers are drawn (look at the seed), or an input is wrong",
            "sampling",
        )


def _is_constant(episodes: Sequence[EpisodeAnswers], spread: Differences) -> bool:
    adapter = [chunk for episode in episodes for chunk in episode.adapter if len(chunk) > 1]
    golden = [chunk for episode in episodes for chunk in episode.golden if len(chunk) > 1]
    return bool(adapter) and _moves(adapter, spread) <= _SAME < _moves(golden, spread)


def _moves(chunks: Sequence[Sequence[object]], spread: Differences) -> float:
    """Return the largest share that a number moves by within a chunk."""
    largest = 0.0
    for chunk in chunks:
        for key, values in columns([chunk]).items():  # type: ignore[list-item]
            for index in range(values.shape[1]):
                largest = max(largest, float(np.ptp(values[:, index])) / spread[f"{key}[{index}]"])
    return largest


@dataclass(frozen=True)
class _JudgedAnswer:
    """Where an answer stands, and whether it is right.

    Attributes:
        episode: number of the episode of its environment, from 0.
        earlier: questions before it in the episode, or observations before it.
        is_right: whether it is the golden one.
    """

    episode: int
    earlier: int
    is_right: bool


def _memory(
    episodes: Sequence[EpisodeAnswers], spread: Differences, tolerance: float, kind: PolicyKind
) -> Iterator[Pattern]:
    """Tell which answers of the episodes are right: those that need nothing from before, or those of first episodes."""
    answers = list(_answers(episodes, spread, tolerance, by_question=kind.keeps_state))
    later = [one.is_right for one in answers if one.earlier]
    begins = [one.is_right for one in answers if not one.earlier]
    again = [one.is_right for one in answers if not one.earlier and one.episode]
    convention = "recurrent" if kind.keeps_state else "history_length" if kind.history > 1 else "action_reference"
    others = tuple(one for one in HISTORY if convention in HISTORY and one != convention)
    remembers = kind.keeps_state or kind.history > 1
    if begins and later and all(begins) and (not any(later) or (remembers and sum(later) <= _FEW * len(later))):
        cause = {
            "recurrent": "the state is not carried on, or not as often as the model does it",
            "history_length": "earlier observations are not the model's: how many, which, or in which order",
            "action_reference": "something is remembered that the model does not remember, or the other way round",
        }[convention]
        words = f"answers to the first observation of an episode are right, and later ones are not: {cause}"
        yield Pattern(words, convention, others)
    elif again and answers[0].is_right and not any(again) and remembers:
        cause = "the first episode begins right, and later ones do not: what is remembered outlives a reset"
        yield Pattern(cause, convention, others)
    elif len(answers) > _MANY and answers[0].is_right and not any(one.is_right for one in answers[1:]):
        yield Pattern("only the very first answer is right: something of it is kept, also over a reset", "recurrent")


def _answers(
    threads: Sequence[EpisodeAnswers], spread: Differences, tolerance: float, *, by_question: bool
) -> Iterator[_JudgedAnswer]:
    episode_counts: dict[Any, int] = {}
    for episode in threads:
        env = episode.observations[0].get(spec.Obs.ENV_IDX) if episode.observations else None
        number = episode_counts[env] = episode_counts.get(env, -1) + 1
        for index, (slot, golden_chunk, adapter_chunk) in enumerate(
            zip(episode.asked_at, episode.golden, episode.adapter, strict=True)
        ):
            share = max(differences([golden_chunk], [adapter_chunk], spread).values())
            yield _JudgedAnswer(number, index if by_question else slot, share <= tolerance)


def _steps(episodes: Sequence[EpisodeAnswers], spread: Differences, tolerance: float) -> Iterator[Pattern]:
    """Tell if the first step of each chunk is right, and later ones are not."""
    golden = [chunk for episode in episodes for chunk in episode.golden]
    adapter = [chunk for episode in episodes for chunk in episode.adapter]
    if any(len(one) != len(other) or len(one) < 2 for one, other in zip(golden, adapter, strict=True)):
        return
    begins = differences([chunk[:1] for chunk in golden], [chunk[:1] for chunk in adapter], spread)
    if max(begins.values()) <= tolerance:
        words = (
            "the first step of each chunk is right, and later ones are not: steps are counted from each other otherwise"
        )
        yield Pattern(words, "action_reference")


def _is_drawn(episodes: Sequence[EpisodeAnswers], spread: Differences) -> bool:
    golden = columns([chunk for episode in episodes for chunk in episode.golden])
    adapter = columns([chunk for episode in episodes for chunk in episode.adapter])
    for key, values in golden.items():
        if key not in adapter or adapter[key].shape != values.shape:
            return False
        residuals = adapter[key] - values
        error = residuals.std(0) / np.sqrt(len(residuals))
        if (np.abs(residuals.mean(0)) > _SIGMAS * error + _SAME * spread[f"{key}[0]"]).any():
            return False
    return True
