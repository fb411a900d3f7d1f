"""Filter of a resampling, antialias, and whether bytes or floats are resampled.

Source: spec/v1/model_io.schema.json#/$defs/filter; the filters themselves are `xpl.image_resize`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl.catalogue import AdapterCase, Convention, Mistake, image_changes
from xpl.catalogue.edits import Block, mistakes_at_sites
from xpl.catalogue.image_changes import Steps, StepsChange, change_steps, set_in_steps

if TYPE_CHECKING:
    from collections.abc import Iterator

_NAME = "image_filter"
_RESAMPLED = ("resize", "letterbox")

FILTERS: tuple[tuple[str, bool], ...] = (
    ("bilinear", True),
    ("bilinear", False),
    ("area", False),
    ("bicubic", True),
    ("bicubic", False),
    ("lanczos", True),
    ("nearest", False),
)
"""Filter and antialias, the likeliest first."""


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = image_changes.sites(case.block)
    for value in (True, False):
        edit = change_steps(set_in_steps(_RESAMPLED, "antialias", value, default=False))
        yield from mistakes_at_sites(sites, 1, f"antialias: {str(value).lower()}", _NAME, edit)
    for kind in dict.fromkeys(name for name, _ in FILTERS):
        for antialias, rank in ((None, 1), (True, 2), (False, 2)):
            label = f"filter: {kind}" + ("" if antialias is None else f", antialias: {str(antialias).lower()}")
            yield from mistakes_at_sites(sites, rank, label, _NAME, change_steps(_set_filter(kind, antialias)))
    for kind in ("float", "uint8"):
        yield from mistakes_at_sites(
            sites, 2, f"as: {kind}", _NAME, change_steps(set_in_steps(_RESAMPLED, "as", kind, "uint8"))
        )


def _set_filter(kind: str, antialias: bool | None) -> StepsChange:  # noqa: FBT001 - a word of the block
    def change(steps: Steps) -> Steps:
        more = {} if antialias is None else {"antialias": antialias}
        return [
            {name: {**how, "filter": kind, **more}} if name in _RESAMPLED else step
            for step in steps
            for name, how in step.items()
        ]

    return change


def _resizes(block: Block) -> bool:
    images = block.get("images") or ()
    steps = [step for image in images for step in (image["steps"] if isinstance(image.get("steps"), list) else ())]
    return any(set(_RESAMPLED) & set(step) for step in steps)


CONVENTION = Convention(
    _NAME, config_mistakes=_config_mistakes, keys={"steps": ["filter", "antialias", "as"]}, applies=_resizes
)
