"""Output: data on stdout, everything else on stderr."""

from __future__ import annotations

import json
import sys
from typing import Any


def data(text: str) -> None:
    """Write an answer to stdout."""
    sys.stdout.write(text if text.endswith("\n") else text + "\n")
    sys.stdout.flush()


def data_json(value: Any) -> None:
    """Write an answer to stdout as JSON."""
    data(json.dumps(value, indent=2, ensure_ascii=False))


def rich(renderable: Any) -> None:
    """Write an answer for people to stdout: in colour on a terminal, plain and unwrapped elsewhere."""
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=not sys.stdout.isatty())
    console.print(renderable)


def note(text: str) -> None:
    """Write a remark to stderr."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
