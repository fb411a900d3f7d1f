"""Names and limits of native code and its pairs, as the standard says them (spec/v1/package.yml)."""

from __future__ import annotations

from typing import Final

from xpl_cli.standard import spec

_PACKAGE: Final = spec.data("package")

CODE: Final[str] = _PACKAGE["files"]["native"]
"""The file that answers as the authors' own code does."""
PAIRS: Final[str] = _PACKAGE["files"]["native_pairs"]
"""The file with what it answered."""
CONVENTIONS: Final[str] = _PACKAGE["native"]["conventions"]
"""Its map of conventions to their sources."""
ANSWERS: Final[str] = _PACKAGE["native"]["answers"]
"""Its function that makes what answers."""
ASSUMED: Final[str] = _PACKAGE["native"]["assumed"]
"""How a source begins that is none."""
PAIRS_BYTES: Final[int] = _PACKAGE["native"]["limits"]["pairs_bytes"]
RECORD_S: Final[float] = _PACKAGE["native"]["limits"]["record_s"]
