"""Errands: what reads one file, writes answers to another, and ends; the side of the policy's interpreter.

Standard library and numpy only. What is asked is a packed map (`xpl.wire.packed`); so is each answer, after its length
(u64, little endian), written when it is known: whoever waits sees how far it came. SIGUSR1 prints where the process is,
and whatever threads are left, it ends when all is said.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import struct
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Callable, NoReturn

from xpl import _spec as spec
from xpl.wire import packed

LENGTH = struct.Struct("<Q")
"""What stands before each answer in the file."""
FAILURES = (Exception, SystemExit)
"""What counts as an error of the code that is run. SystemExit, too: see `xpl.worker.main`."""
ERROR = "error"
Order = Mapping[str, Any]
"""What an errand is asked: the keys stand in its module."""


def carry_out(asked: str, answers: str, play: Callable[[Order], Iterator[bytes]]) -> NoReturn:
    """Do what the file `asked` says, write the answers to the file `answers`, and end the process.

    Args:
        asked: path of a packed map.
        answers: path.
        play: yields the answers, packed, each before the next thing can change it.
    """
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    order = packed.decode(Path(asked).read_bytes())
    with Path(answers).open("wb", buffering=0) as told:
        told.writelines(LENGTH.pack(len(answer)) + answer for answer in play(order))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # a model's threads may go on for ever


def result(value: object) -> bytes:
    """Return an answer, packed."""
    return b"".join(packed.encode({spec.Payload.RESULT: value}))


def failed(error: BaseException, **more: Any) -> bytes:
    """Return an answer that is an error, packed."""
    return b"".join(packed.encode({ERROR: f"{type(error).__name__}: {error}", **more}))
