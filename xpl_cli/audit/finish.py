"""Digests and fingerprints: what makes two runs comparable, and what shows that they agree."""

from __future__ import annotations

import hashlib
import platform
import sys
from pathlib import Path
from typing import Any

import yaml

import xpl_cli
from xpl_cli.audit.model import Gate

_LIBRARIES = {Gate.STATIC: (), Gate.OFFLINE: ("numpy", "pillow"), Gate.MUJOCO: ("numpy", "mujoco-core")}


def fingerprint(gate: Gate) -> str:
    """Return a short hash of what a gate's digest may depend on besides the adapter.

    The static gate depends on the tool and the parser; the others also on numpy, MuJoCo, the C library and the features
    of the processor, because floating-point results differ between these.
    """
    parts = [xpl_cli.__version__, gate, f"{sys.version_info.major}.{sys.version_info.minor}"]
    parts += [f"{name} {_version(name)}" for name in _LIBRARIES[gate]]
    if gate is Gate.STATIC:
        parts.append(f"PyYAML {yaml.__version__}")
    else:
        parts += [platform.machine(), *platform.libc_ver(), _cpu_features()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:8]


def _version(name: str) -> str:
    from importlib import metadata  # slow to import, and the static gate needs none of it

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "none"


def _cpu_features() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor()
    return next((line for line in text.splitlines() if line.startswith(("flags", "Features"))), "")


class Recorder:
    """Hashes what an adapter answered, in order. Arrays count by dtype, shape and bytes."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, label: str, value: Any) -> None:
        """Add one answer."""
        self._hash.update(label.encode())
        self._value(value)

    def record(self) -> str:
        """Return the hash of everything so far."""
        return self._hash.hexdigest()[:16]

    def _value(self, value: Any) -> None:
        import numpy as np

        if isinstance(value, dict):
            for key in sorted(value):
                self._hash.update(str(key).encode())
                self._value(value[key])
        elif isinstance(value, (list, tuple)):
            self._hash.update(f"[{len(value)}".encode())
            for item in value:
                self._value(item)
        elif isinstance(value, (np.ndarray, np.generic)):
            array = np.asarray(value)
            self._hash.update(f"{array.dtype.str}{array.shape}".encode())
            self._hash.update(array.tobytes())
        else:
            self._hash.update(repr(value).encode())
