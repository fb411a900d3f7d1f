"""Our own modules in further processes: found where this one found them, whatever lies in the working directory."""

from __future__ import annotations

import sys
from pathlib import Path

_START = (
    "import runpy, sys; sys.path[0] = sys.argv.pop(1); "
    "runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)


def command(module: str) -> list[str]:
    """Return the words that run a module as `python -m` does, but never from a folder `xpl` that lies around."""
    return [sys.executable, "-c", _START, str(Path(__file__).resolve().parents[2]), module]
