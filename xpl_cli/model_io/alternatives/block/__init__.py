"""Every single change of a model_io block's own words that may be what is wrong with it.

for change in alternatives(manifest["model_io"], embodiment, "joint", [package]):
    change.words, change.convention, change.block      # "channels: bgr", "image_channels", {...}
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from xpl.convert import ConversionError, compile_interface
from xpl_cli.model_io.alternatives.block.edits import Block, Candidate, edited
from xpl_cli.model_io.alternatives.block.images import images
from xpl_cli.model_io.alternatives.block.joints import arms, grippers, joints, order
from xpl_cli.model_io.alternatives.block.numbers import numbers
from xpl_cli.model_io.alternatives.block.poses import poses
from xpl_cli.model_io.alternatives.block.timing import histories, instructions, references
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from pathlib import Path

    from xpl.convert import Interface
    from xpl.embodiment import Embodiment

__all__ = ["Alternative", "alternatives"]


@dataclass(frozen=True)
class Alternative:
    """One change of a model_io block.

    Attributes:
        words: what is changed, as a finding says it: "channels: bgr (wrists)".
        convention: which convention it is about, of the vocabulary of reference.py.
        block: the changed block; valid, and it fits the robot.
    """

    words: str
    convention: str
    block: dict[str, Any]


def alternatives(  # noqa: PLR0913, PLR0917 - what is known of the adapter
    model_io: Block,
    embodiment: Embodiment,
    action_type: str,
    folders: Sequence[Path] = (),
    chunk: int | None = None,
    templates: Sequence[str] = (),
) -> Iterator[Alternative]:
    """Yield every single change of the block that fits the robot, each block once, the likeliest first.

    A change may be made at several places that one mistake covers: all images, the state and the action. The widths of
    vectors stay.

    Args:
        model_io: the block, valid by its schema.
        embodiment: the robot.
        action_type: joint or ee.
        folders: where files of statistics may lie.
        chunk: action steps that the manifest declares.
        templates: of instructions, besides those that are known.

    Raises:
        ConversionError: if the block itself does not fit.
    """
    widths = _widths(compile_interface(model_io, embodiment, action_type, folders, chunk))
    seen = {_same(model_io)}
    for candidate in sorted(_candidates(model_io, embodiment, folders, templates), key=lambda one: one.rank):
        block = edited(model_io, candidate.edits)
        text = _same(block)
        if text in seen:
            continue
        seen.add(text)
        try:
            fits = _widths(compile_interface(block, embodiment, action_type, folders, chunk)) == widths
        except ConversionError:
            continue
        if fits and _is_valid(block):
            yield Alternative(candidate.words, candidate.convention, block)


def _candidates(
    block: Block, embodiment: Embodiment, folders: Sequence[Path], templates: Sequence[str]
) -> Iterator[Candidate]:
    yield from images(block, embodiment.cameras)
    yield from grippers(block, embodiment)
    yield from arms(block)
    yield from joints(block, embodiment)
    yield from poses(block)
    yield from references(block)
    yield from numbers(block, folders)
    yield from histories(block)
    yield from instructions(block, templates)
    yield from order(block)


def _same(block: Block) -> str:
    return json.dumps(block, sort_keys=True)


def _widths(interface: Interface) -> list[int]:
    return [interface.action.vector.padded, *(vector.padded for vector in interface.states.values())]


def _is_valid(block: Block) -> bool:
    return bool(_validator().is_valid(block))


@cache
def _validator() -> Any:
    import jsonschema_rs

    return jsonschema_rs.validator_for(spec.schema("model_io"))
