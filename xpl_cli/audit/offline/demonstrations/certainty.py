"""Whether one convention fits better than another: a paired bootstrap over episodes, and how many would be enough."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.offline.demonstrations.action_errors import ActionErrors

LEAST_EPISODES: Final = 5
"""With four episodes, one of sixteen useless changes is better in all of them by chance."""
BETTER: Final = 0.8
"""What fits better leaves this share of the error, or less, ..."""
CERTAIN: Final = 0.92
"""... and with 99 % certainty this one, or less."""
_RESAMPLES: Final = 2000
_ONE_SIDED: Final = 99.0
_Z: Final = 2.33


@dataclass(frozen=True)
class Margin:
    """The error of a change relative to the declared conventions.

    Attributes:
        share: the error with the change, as a share of the error without.
        least, most: bounds of the share, 99 % one-sided each.
        needed: about how many episodes would make a margin of this size certain.
    """

    share: float
    least: float
    most: float
    needed: int

    @property
    def is_better(self) -> bool:
        """Whether it fits better."""
        return self.share <= BETTER

    @property
    def is_certain(self) -> bool:
        """Whether the episodes are enough to say so."""
        return self.is_better and self.most <= CERTAIN


def margin(declared: ActionErrors, changed: ActionErrors, episodes: Sequence[int]) -> Margin | None:
    """Return the relative error of a change, None where too few of its actions are known.

    Args:
        declared: errors under the declared conventions.
        changed: those with the change, of the same questions.
        episodes: of each question, the number of its episode.
    """
    is_known = declared.known
    if 3 * (is_known & changed.known).sum() < is_known.sum():
        return None
    # Where it is not known what the change would command, it gains nothing.
    other = np.where(changed.known, changed.steps, declared.steps)
    numbers = np.unique(np.asarray(episodes))
    sums = np.zeros((2, len(numbers)))
    for slot, number in enumerate(numbers):
        chosen = is_known & (np.asarray(episodes) == number)[:, None]
        if chosen.any():
            sums[:, slot] = declared.steps[chosen].mean(), other[chosen].mean()
    before, after = sums
    if not before.sum() > 0:
        return None
    resamples = np.random.default_rng(0).integers(0, len(numbers), (_RESAMPLES, len(numbers)))
    shares = after[resamples].sum(1) / np.maximum(before[resamples].sum(1), 1e-12)
    gained = before - after
    mean_gain = gained.mean() - (1 - CERTAIN) * before.mean()
    noise = float(gained.std(ddof=1)) if len(numbers) > 1 else 0.0
    needed = math.ceil((_Z * noise / mean_gain) ** 2) + 1 if mean_gain > 0 else len(numbers) + 1
    least, most = np.percentile(shares, (100 - _ONE_SIDED, _ONE_SIDED))
    return Margin(
        share=float(after.sum() / before.sum()),
        least=float(least),
        most=float(most),
        needed=max(LEAST_EPISODES, needed, len(numbers) + 1),
    )
