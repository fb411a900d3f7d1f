"""Conventions that apply to an adapter and its model, whose sources reference.py cites."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk

if TYPE_CHECKING:
    from xpl.manifest import Manifest, ModelIO

_IMAGES = ("camera", "image_channels", "image_orientation", "image_range", "image_size")
HISTORY = ("history_length", "history_order", "history_padding", "history_stride")
"""Conventions of an observation history."""
_OF_PARTS: Mapping[str, tuple[str, ...]] = {
    "joints": ("joint_order", "angle_unit"),
    "hand": ("joint_order", "angle_unit"),
    "gripper": ("gripper",),
    "position": ("frame", "point"),
    "rotation": ("rotation", "frame", "point"),
}
_JOINT = sdk.ACTION_TYPES[0]
_TEXT = sdk.Obs.INSTRUCTION
"""Name of the instruction in the standard, in the block and as a convention."""


_DECLARING_KEYS: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    "images": (("channels", "image_channels", "channels"), ("layout", "image_range", "layout")),
    "joints": (("unit", "angle_unit", "angle_unit"),),
    "hand": (("unit", "angle_unit", "angle_unit"),),
    "rotation": (("form", "rotation", "form"),),
}
"""By kind of entry: a key, its convention, and its definition in the schema."""


@dataclass(frozen=True)
class DeclaredValue:
    """A value that a model_io block declares.

    Attributes:
        definition: definition in the schema with all values.
        word: the value.
    """

    definition: str
    value: str


def declared_values(model_io: ModelIO) -> dict[str, list[DeclaredValue]]:
    """Return the declared values of a block by convention, where a value is one name."""
    entries = [("images", image) for image in model_io.images]
    for vector in (*model_io.state, model_io.action):
        entries += [(kind, how) for part in _list(vector.get("parts")) for kind, how in part.items()]
    values: dict[str, list[DeclaredValue]] = {}
    for kind, entry in entries:
        for key, convention, definition in _DECLARING_KEYS.get(kind, ()):
            value = entry.get(key, "rad" if key == "unit" else None)
            if isinstance(value, str):
                values.setdefault(convention, []).append(DeclaredValue(definition, value))
    return values


def applicable_conventions(manifest: Manifest) -> list[str]:
    """Return the names of the conventions that apply to a policy, sorted.

    Args:
        manifest: policy.yml; its model_io block determines the conventions, without one its inputs and actions do.
    """
    if manifest.model_io is None:
        return sorted({"action_reference", "chunk", *_of_manifest(manifest)})
    from xpl.catalogue import convention as catalogue  # which needs numpy

    return catalogue.applying(manifest.model_io.data)


def _of_manifest(manifest: Manifest) -> Iterator[str]:
    if any(name.startswith(f"{sdk.Obs.VISION}.") for name in manifest.read):
        yield from _IMAGES
    if _TEXT in manifest.read:
        yield _TEXT
    for action_type in manifest.action_types:
        yield from _OF_PARTS["joints" if action_type == _JOINT else "rotation"]
    if manifest.gripper:
        yield "gripper"
    yield "normalization"
    if manifest.temporal.history > 1:
        yield from HISTORY
    if manifest.temporal.kind == "memory":
        yield "recurrent"
    if not manifest.deterministic:
        yield "sampling"


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []
