"""An adapter without its model: its conversions, before the model is trained."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl import json_text, variants
from xpl.manifest import Manifest
from xpl.policy import Policy
from xpl.worker.loading import load_model_class

if TYPE_CHECKING:
    from xpl.contract import Config

MANIFEST_VARIABLE = "XPL_MANIFEST"
"""Environment variable by which `xpl prepare` and `xpl train` pass policy.yml to a script, as JSON."""


class TrainingError(ValueError):
    """Training data cannot be made; the message has the expected value and the remedy."""


def without_model(
    folder: str | os.PathLike[str],
    config: Config,
    *,
    normalized: bool = True,
    images: bool = True,
    as_bytes: bool = False,
) -> Policy:
    """Return a package's adapter without `load`: it encodes and decodes, and cannot predict.

    Args:
        folder: folder of the package.
        config: configuration of the run (`$XPL_CONFIG`). Without the key `manifest`, the manifest is that of
            `$XPL_MANIFEST`, or policy.yml.
        normalized: False removes every `normalize` of the block, so that no statistics are needed.
        images: False removes the block's images.
        as_bytes: images stay uint8: range, mean and std are removed.

    Returns:
        An instance of the adapter's class.

    Raises:
        TrainingError: the class in model.py does not derive from `xpl.Policy`, or there is no block `model_io`.
        ConversionError: the block does not fit the robot, or statistics are missing.
    """
    manifest = copy.deepcopy(dict(manifest_of(folder, config)))
    base = load_model_class(Path(folder).resolve(), Manifest.parse(manifest).model_class)
    if not issubclass(base, Policy):
        raise TrainingError(f"{folder}: {base.__name__} is no xpl.Policy; its conversions cannot be called")
    model_io = manifest.get("model_io")
    if model_io is None:
        raise TrainingError(f"{folder}: policy.yml has no block model_io, by which recorded actions are converted")
    if not normalized:
        for vector in (*model_io.get("state", ()), model_io["action"]):
            vector.pop("normalize", None)
    if not images:
        model_io.pop("images", None)
    for entry in model_io.get("images", ()) if as_bytes else ():
        for key in ("range", "mean", "std"):
            entry.pop(key, None)
        entry["dtype"] = "uint8"
    unloaded = type(base.__name__, (base,), {"load": _no_load, "__module__": base.__module__})
    made: Policy = unloaded({**config, "manifest": manifest})
    return made


def _no_load(_self: Policy, _config: Config) -> None:
    """Replace an adapter's `load`."""


def manifest_of(folder: str | os.PathLike[str], config: Config) -> Mapping[str, Any]:
    """Return a package's manifest: from the configuration, `$XPL_MANIFEST`, or policy.yml."""
    manifest: Mapping[str, Any] = config.get("manifest") or _manifest(Path(folder), config.get(spec.Deploy.VARIANT))
    return manifest


def _manifest(folder: Path, variant: str | None) -> Mapping[str, Any]:
    text = os.environ.get(MANIFEST_VARIABLE)
    if text is not None:
        manifest: Mapping[str, Any] = json_text.parse(text)
        return manifest
    path = folder / spec.File.POLICY_YML
    try:
        import yaml
    except ImportError:
        raise TrainingError(
            f"{path} is read by PyYAML, which is not installed: run `xpl train`, or `pip install pyyaml`"
        ) from None
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    if not isinstance(document, Mapping):
        raise TrainingError(f"{path} holds no map")
    return variants.apply_variant(document, variant)[0]
