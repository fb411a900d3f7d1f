"""Variants of a policy: the same adapter with other inputs, another network or other weights.

policy.yml declares them, and the key `variant` of a run's configuration selects one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_VARIANTS, _DEPLOY = "variants", "deploy"


class VariantError(ValueError):
    """A configuration names a variant that policy.yml does not have."""


def apply_variant(manifest: Mapping[str, Any], name: str | None) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return policy.yml of a variant, and its merge patch of deploy.yml.

    Args:
        manifest: content of policy.yml.
        name: name of the variant; None for the policy itself.

    Raises:
        VariantError: there is no such variant.
    """
    if name is None:
        return manifest, {}
    variants = manifest.get(_VARIANTS)
    if not isinstance(variants, Mapping) or not isinstance(variants.get(name), Mapping):
        names = ", ".join(map(str, variants)) if isinstance(variants, Mapping) and variants else "none"
        raise VariantError(f"policy.yml has no variant {name!r}; its variants: {names}")
    patch = {key: value for key, value in variants[name].items() if key != _DEPLOY}
    return merge_patch(manifest, {**patch, _VARIANTS: None}), variants[name].get(_DEPLOY) or {}


def merge_patch(document: object, patch: object) -> Any:
    """Return a document after a JSON merge patch (RFC 7396); neither is changed."""
    if not isinstance(patch, Mapping):
        return patch
    result = dict(document) if isinstance(document, Mapping) else {}
    for key, value in patch.items():
        if value is None:
            result.pop(key, None)
        else:
            result[key] = merge_patch(result.get(key), value)
    return result
