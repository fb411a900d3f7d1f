"""Install commands for optional libraries, by the libraries' own names.

The tool's own name with an extra (`xpl-cli[hub]`) need not exist on the user's package index.
"""

from __future__ import annotations

import shlex
from importlib import metadata
from pathlib import Path

_CHECKOUT = Path(__file__).parents[2]


def how_to_install(extra: str) -> str:
    """Return the command that installs the libraries of an extra.

    Args:
        extra: its name in pyproject.toml.
    """
    try:
        declared = metadata.requires("xpl-cli") or []
    except metadata.PackageNotFoundError:  # run from a checkout that is not installed
        return shlex.join(["pip", "install", f"{_CHECKOUT}[{extra}]"])
    requirements = [line.partition(";") for line in declared]
    packages = [
        name.strip() for name, _, marker in requirements if extra in marker.replace('"', " ").replace("'", " ").split()
    ]
    return shlex.join(["pip", "install", *packages])
