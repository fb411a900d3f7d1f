"""Radians or degrees. Source: spec/v1/model_io.schema.json#/$defs/angle_unit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import AdapterCase, Convention, Mistake, fields
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import copy_between_state_and_action, mistakes_at_sites, parts, set_key

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl.embodiment import Embodiment

_NAME = "angle_unit"

UNITS = {"rad": 1.0, "deg": float(np.rad2deg(1.0))}
"""What a radian is in each unit."""


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = parts(case.block, "joints", "hand") if case.block else []
    for unit in ("deg", "rad"):
        yield from mistakes_at_sites(sites, 0, f"unit: {unit}", _NAME, set_key("unit", unit, "rad"))
    yield from copy_between_state_and_action(case.block, ["joints"], "unit", _NAME) if case.block else ()


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for change in _changes(case.embodiment):
        yield from fields.field_mistakes(change, case)


def _changes(embodiment: Embodiment) -> Iterator[fields.FieldChange]:
    for extra_rank, label, prefixes in fields.arm_scopes(embodiment.prefixes):
        keys = [prefix + spec.State.ARM_JOINT_STATE for prefix in prefixes]
        yield fields.linear(extra_rank, f"unit{label}: deg", _NAME, keys, UNITS["deg"])
        yield fields.linear(extra_rank, f"unit{label}: rad, not deg", _NAME, keys, 1 / UNITS["deg"])
    if embodiment.arms[0].gripper != "parallel_gripper":
        hands = [prefix + spec.State.EE_JOINT_STATE for prefix in embodiment.prefixes]
        yield fields.linear(0, "unit of hands: deg", _NAME, hands, UNITS["deg"])
        yield fields.linear(0, "unit of hands: rad, not deg", _NAME, hands, 1 / UNITS["deg"])


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    keys={"joints": ["unit"], "hand": ["unit"]},
    applies=lambda block: bool({"joints", "hand"} & kinds(block)),
)
