"""Variants of a policy: one adapter with other inputs, another network or other weights.

policy.yml describes them, and the key `variant` of a run's configuration chooses one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_VARIANTS, _DEPLOY = "variants", "deploy"


class VariantError(ValueError):
    """A configuration names a variant that policy.yml does not have."""


def chosen(manifest: Mapping[str, Any], name: str | None) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return policy.yml as a variant has it, and the merge patch of deploy.yml that belongs to it.

    Args:
        manifest: what policy.yml holds.
        name: of the variant; None is the policy itself, which changes nothing.

    Raises:
        VariantError: if there is no such variant.
    """
    if name is None:
        return manifest, {}
    known = manifest.get(_VARIANTS)
    if not isinstance(known, Mapping) or not isinstance(known.get(name), Mapping):
        there = ", ".join(map(str, known)) if isinstance(known, Mapping) and known else "none"
        raise VariantError(f"policy.yml has no variant {name!r}; its variants: {there}")
    patch = {key: value for key, value in known[name].items() if key != _DEPLOY}
    return merged(manifest, {**patch, _VARIANTS: None}), known[name].get(_DEPLOY) or {}


def merged(document: object, patch: object) -> Any:
    """Return a document after a JSON merge patch (RFC 7396); neither is changed."""
    if not isinstance(patch, Mapping):
        return patch
    result = dict(document) if isinstance(document, Mapping) else {}
    for key, value in patch.items():
        if value is None:
            result.pop(key, None)
        else:
            result[key] = merged(result.get(key), value)
    return result
