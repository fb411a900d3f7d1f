"""Usual mistakes as other values of a model_io block: those that fit the robot, each with the edited block.

for mistake, block in in_block(AdapterCase(embodiment, "joint", block=manifest["model_io"], folders=[package])):
    mistake.description, mistake.convention, block      # "channels: bgr", "image_channels", {...}
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

from xpl.catalogue import convention as catalogue
from xpl.catalogue.edits import apply_edits
from xpl.convert import ConversionError, compile_interface
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from xpl.catalogue import AdapterCase, Mistake
    from xpl.convert import Interface


def in_block(case: AdapterCase, chunk: int | None = None) -> Iterator[tuple[Mistake, dict[str, Any]]]:
    """Yield every mistake of the block that fits the robot, each block once, the likeliest first.

    A mistake may be made at several places: all images, the state and the action. The widths of vectors stay.

    Args:
        case: the adapter; its block is valid by its schema.
        chunk: action steps that the manifest declares.

    Raises:
        ConversionError: if the block itself does not fit.
    """
    mistakes = list(catalogue.config_mistakes(case))
    yield from ((mistakes[index], made) for index, made in fitting_blocks(case, mistakes, chunk))


def fitting_blocks(
    case: AdapterCase, mistakes: Iterable[Mistake], chunk: int | None = None
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the indices of the mistakes that fit, with their blocks; each block once, without the block itself.

    Raises:
        ConversionError: if the block itself does not fit.
    """
    block: Mapping[str, Any] = case.block

    def widths(of: Mapping[str, Any]) -> list[int]:
        return _widths(compile_interface(of, case.embodiment, case.action_type, case.folders, chunk))

    own_widths, texts = widths(block), {_canonical(block)}
    for index, mistake in enumerate(mistakes):
        try:
            made = apply_edits(block, mistake.edits or {})
        except (KeyError, IndexError, TypeError):  # of two mistakes one takes out what the other changes
            continue
        text = _canonical(made)
        if text in texts:
            continue
        texts.add(text)
        try:
            fits = widths(made) == own_widths
        except ConversionError:
            continue
        if fits and _validator().is_valid(made):
            yield index, made


def _canonical(block: Mapping[str, Any]) -> str:
    return json.dumps(block, sort_keys=True)


def _widths(interface: Interface) -> list[int]:
    return [interface.action.vector.padded, *(vector.padded for vector in interface.states.values())]


@cache
def _validator() -> Any:
    import jsonschema_rs

    return jsonschema_rs.validator_for(spec.schema("model_io"))
