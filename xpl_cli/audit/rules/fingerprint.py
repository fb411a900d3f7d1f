"""Fingerprints: what makes two runs comparable."""

from __future__ import annotations

import hashlib
import platform
import sys
from pathlib import Path

import yaml

import xpl_cli
from xpl_cli.audit.rules.gates import Gate

_LIBRARIES = {Gate.STATIC: (), Gate.OFFLINE: ("numpy", "pillow"), Gate.MUJOCO: ("numpy", "mujoco-core")}


def fingerprint(gate: Gate, stood_in: str = "") -> str:
    """Return a short hash of what a gate's digest may depend on besides the adapter.

    The static gate depends on the tool and the parser; the others also on numpy, MuJoCo, the C library and the features
    of the processor, because floating-point results differ between these, and on what stood in for the model.
    """
    parts = [xpl_cli.__version__, gate, f"{sys.version_info.major}.{sys.version_info.minor}"]
    parts += [f"{name} {_version(name)}" for name in _LIBRARIES[gate]]
    if gate is Gate.STATIC:
        parts.append(f"PyYAML {yaml.__version__}")
    else:
        parts += [stood_in, platform.machine(), *platform.libc_ver(), _cpu_features()]
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
