"""Which conventions an adapter and its model have to share: those that native.py names the sources of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from xpl import _spec as sdk

_IMAGES = ("camera", "image_channels", "image_orientation", "image_range", "image_size")
_OF_PARTS: Mapping[str, tuple[str, ...]] = {
    "joints": ("joint_order", "angle_unit"),
    "hand": ("joint_order", "angle_unit"),
    "gripper": ("gripper",),
    "position": ("frame", "point"),
    "rotation": ("rotation", "frame", "point"),
}
_JOINT = sdk.ACTION_TYPES[0]
_TEXT = sdk.Obs.INSTRUCTION
"""The standard's name for it, which the block and the convention share."""


def applying(manifest: Mapping[str, Any]) -> list[str]:
    """Return the conventions that apply to a policy, sorted.

    Args:
        manifest: policy.yml. Its native block says what there is to agree on; without one, its inputs and actions do.
    """
    native = manifest.get("native")
    found = _of_block(native) if isinstance(native, Mapping) else _of_manifest(manifest)
    return sorted({"action_reference", "chunk", *found})


def _of_block(native: Mapping[str, Any]) -> Iterator[str]:
    images = native.get("images") or ()
    if images:
        yield from _IMAGES
    steps = [step for image in images for step in _list(image.get("steps"))]
    if any({"resize", "letterbox"} & set(step) for step in steps):
        yield "image_filter"
    vectors = [*(native.get("state") or ()), native.get("action") or {}]
    for kind in (kind for vector in vectors for part in _list(vector.get("parts")) for kind in part):
        yield from _OF_PARTS.get(kind, ())
    if any(vector.get("normalize") is not None or "pad" in vector for vector in vectors):
        yield "normalization"
    if (native.get("history") or {}).get("length", 1) != 1:
        yield "history"
    if native.get(_TEXT) is not None:
        yield _TEXT
    if native.get("sampling", "none") != "none":
        yield "sampling"
    if native.get("recurrent"):
        yield "recurrent"


def _of_manifest(manifest: Mapping[str, Any]) -> Iterator[str]:
    inputs, temporal = manifest.get("inputs") or {}, manifest.get("temporal") or {}
    read = [str(name) for group in ("required", "optional") for name in inputs.get(group) or ()]
    if any(name.startswith(f"{sdk.Obs.VISION}.") for name in read):
        yield from (*_IMAGES, "image_filter")
    if _TEXT in read:
        yield _TEXT
    for action_type in manifest.get("action_types") or ():
        yield from _OF_PARTS["joints" if action_type == _JOINT else "rotation"]
    if manifest.get("gripper"):
        yield "gripper"
    yield "normalization"
    if (temporal.get("history") or 1) > 1:
        yield "history"
    if temporal.get("kind") == "memory":
        yield "recurrent"
    if manifest.get("deterministic") is False:
        yield "sampling"


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
