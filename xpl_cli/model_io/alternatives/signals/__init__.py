"""Single changes around any adapter, in the standard's terms, for conversions that code does by hand.

for signal in signals(embodiment, "joint", cameras=cameras, history=2):
    signal.words, signal.convention, signal.shown, signal.commanded
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from xpl_cli.model_io.alternatives.signals import arms, chunks, histories, pictures, poses, references, texts, ways
from xpl_cli.model_io.alternatives.signals.signal import Signal

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

__all__ = ["Signal", "signals"]


def signals(  # noqa: PLR0913 - what is known of the adapter
    embodiment: Embodiment,
    action_type: str,
    *,
    cameras: Sequence[str] = (),
    reads: Sequence[str] | None = None,
    history: int = 1,
    stride: int = 1,
    instructions: Sequence[str] = (),
) -> Iterator[Signal]:
    """Yield every single change around an adapter, the likeliest first; those that cost no play before the others.

    A mistake in the adapter is undone by the change: what is shown is changed so that the model sees what it should,
    what is commanded so that it means what the model meant.

    Args:
        embodiment: the robot.
        action_type: joint or ee.
        cameras: that the adapter reads; none where it reads no pictures.
        reads: fields of the state that it reads, without an arm's prefix; None where that is not known.
        history: observations that it keeps.
        stride: control steps between them.
        instructions: texts of the scripted episodes; none where it reads no text.
    """
    found = _all(embodiment, action_type, cameras, reads, history, stride, instructions)
    yield from sorted(found, key=lambda one: (one.rank, one.shown is not None))


def _all(  # noqa: PLR0913, PLR0917 - as `signals`
    embodiment: Embodiment,
    action_type: str,
    cameras: Sequence[str],
    reads: Sequence[str] | None,
    history: int,
    stride: int,
    instructions: Sequence[str],
) -> Iterator[Signal]:
    yield from references.references(embodiment, action_type, history, stride)
    yield from chunks.chunks(action_type, history)
    for change in itertools.chain(
        arms.joints(embodiment), arms.grippers(embodiment), arms.sides(embodiment), poses.poses(embodiment)
    ):
        yield from ways.signals(change, embodiment, action_type, reads)
        if change.words.startswith("arms:") and cameras:
            with_wrists = replace(change, words=f"{change.words}, wrist cameras too", ways=("both", "state"))
            yield from ways.signals(with_wrists, embodiment, action_type, reads, pictures.wrists)
    if cameras:
        yield from pictures.pictures(cameras)
    if instructions:
        yield from texts.texts(instructions)
    yield from histories.histories(history, action_type, stride)
