"""Readers of YAML, JSON and HDF5 that XPolicyLab's adapters call."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any


def load_json(path: Any) -> Any:
    """Return the content of a JSON file."""
    return json.loads(Path(path).read_text(encoding="utf-8"))  # noqa: TID251 - the policy's own file, as upstream


def load_yaml(path: Any) -> Any:
    """Return the content of a YAML file; needs PyYAML."""
    import yaml

    return yaml.safe_load(Path(path).read_text(encoding="utf-8"))


def load_hdf5(path: Any) -> dict[str, Any]:
    """Return the content of an HDF5 file, groups as maps and its attributes under `_attrs`; needs h5py."""
    h5py = importlib.import_module("h5py")

    with h5py.File(path, "r") as file:
        found = _group(file, h5py)
        if len(file.attrs):
            found["_attrs"] = dict(file.attrs)
        return found


def _group(group: Any, h5py: Any) -> dict[str, Any]:
    return {
        name: _group(item, h5py) if isinstance(item, h5py.Group) else _value(item[()]) for name, item in group.items()
    }


def _value(value: Any) -> Any:
    if isinstance(value, (bytes, bytearray)):
        return value.decode("utf-8", errors="replace")
    return value.item() if getattr(value, "ndim", 1) == 0 else value
