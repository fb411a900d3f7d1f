"""The peers' end of a conversation in lines: one JSON map asks for an operation, one JSON map answers it.

Runs in the peers' interpreters and needs nothing but them. Standard output belongs to the conversation; what a library
prints goes to standard error.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from typing import Any

_OUT = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)


def tell(message: Mapping[str, Any]) -> None:
    _OUT.write(json.dumps(message) + "\n")


def hear() -> dict[str, Any] | None:
    line = sys.stdin.readline()
    return dict(json.loads(line)) if line else None


def answer(operations: Mapping[str, Callable[..., Any]]) -> None:
    """Carry out what is asked, until nothing more is: `{"do": name, ...}` -> `{"result": ...}` or `{"error": ...}`."""
    os.dup2(2, 1)
    while (request := hear()) is not None:
        try:
            reply = {"result": operations[request.pop("do")](**request)}
        except Exception as error:  # noqa: BLE001 - the test decides which errors are right
            reply = {"error": type(error).__name__, "message": str(error), "details": getattr(error, "details", {})}
        tell(reply)
