"""What to type where a library is missing that only some commands need: the library itself, and no name of this tool.

An extra of the tool by its bare name (`xpl-cli[hub]`) would ask an index for a name that it need not have.
"""

from __future__ import annotations

import shlex
from importlib import metadata
from pathlib import Path

_CHECKOUT = Path(__file__).parents[2]


def how_to_install(extra: str) -> str:
    """Return the command that installs what an extra of this tool holds.

    Args:
        extra: its name in pyproject.toml.
    """
    try:
        declared = metadata.requires("xpl-cli") or []
    except metadata.PackageNotFoundError:  # run from a checkout that is not installed
        return shlex.join(["pip", "install", f"{_CHECKOUT}[{extra}]"])
    found = [line.partition(";") for line in declared]
    wanted = [name.strip() for name, _, marker in found if extra in marker.replace('"', " ").replace("'", " ").split()]
    return shlex.join(["pip", "install", *wanted])
