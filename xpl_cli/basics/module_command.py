"""Commands that run modules of this tool in further processes, never modules of the working directory."""

from __future__ import annotations

import sys
from pathlib import Path

_START = (
    "import runpy, sys; sys.path[0] = sys.argv.pop(1); "
    "runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)


def command(module: str) -> list[str]:
    """Return the command that runs a module like `python -m`, but never from the working directory."""
    return [sys.executable, "-c", _START, str(Path(__file__).resolve().parents[2]), module]
