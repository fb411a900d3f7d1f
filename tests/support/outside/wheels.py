"""Packages for tests of installations, made on the spot: no index is asked."""

from __future__ import annotations

import base64
import hashlib
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np


def wheel(folder: Path, name: str, version: str, files: Mapping[str, str], requires: Sequence[str] = ()) -> Path:
    """Write a wheel of pure Python and return its path.

    Args:
        folder: where to.
        name: of the distribution.
        version: of it.
        files: contents by path.
        requires: what it depends on.
    """
    told = f"{name}-{version}.dist-info"
    asked = [f"Requires-Dist: {one}" for one in requires]
    metadata = ["Metadata-Version: 2.1", f"Name: {name}", f"Version: {version}", *asked]
    contents = {
        **files,
        f"{told}/METADATA": "\n".join(metadata) + "\n",
        f"{told}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = [f"{path},sha256={_record_digest(content)},{len(content.encode())}" for path, content in contents.items()]
    contents[f"{told}/RECORD"] = "\n".join([*record, f"{told}/RECORD,,"]) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for inner, content in contents.items():
            archive.writestr(zipfile.ZipInfo(inner, (2020, 1, 1, 0, 0, 0)), content)
    return path


def numpy_wheel(folder: Path) -> Path:
    """Write a wheel of a numpy that is the one of these tests: it leads there, and to nothing beside it."""
    beside = folder / "numpy-alone"
    beside.mkdir(parents=True)
    (beside / "numpy").symlink_to(Path(np.__file__).parent)
    return wheel(folder, "numpy", "99.0", {"numpy_elsewhere.pth": f"{beside}\n"})


def pinned(*wheels: Path) -> str:
    """Return a lock in pip's format with digests."""
    lines = []
    for path in wheels:
        name, version, *_ = path.name.split("-")
        lines.append(f"{name}=={version} --hash=sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}")
    return "\n".join(lines) + "\n"


def _record_digest(content: str) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(content.encode()).digest()).rstrip(b"=").decode()
