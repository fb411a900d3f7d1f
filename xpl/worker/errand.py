"""Errands: what reads one file, writes answers to another, and ends; the side of the policy's interpreter.

Standard library and numpy only. What is asked is a packed map (`xpl.wire.packed`); so is each answer, after its length
(u64, little endian), written when it is known: whoever waits sees how far it came. SIGUSR1 prints where the process is,
and whatever threads are left, it ends when all is said.
"""

from __future__ import annotations

import faulthandler
import itertools
import os
import signal
import struct
import sys
from collections.abc import Iterable, Iterator, Mapping
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
Play = Callable[[Order], Iterator[bytes]]
"""Yields the answers to an order, packed, each before the next thing can change it."""


def carry_out(asked: str, answers: str, play: Play) -> NoReturn:
    """Do what the file `asked` says, write the answers to the file `answers`, and end the process.

    Args:
        asked: path of a packed map.
        answers: path.
        play: yields the answers, packed, each before the next thing can change it.
    """
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    _write(answers, play(packed.decode(Path(asked).read_bytes())))
    _end()


def stand(asked: str, answers: str, load: Callable[[Order], tuple[bytes, Play]]) -> NoReturn:
    """Load something, as the file `asked` says, and then do what each line of the standard input asks.

    A line is a number: orders lie beside `asked`, and answers beside `answers`, in files with this ending. All answers
    to an order end with a length of zero.

    Args:
        asked: path of a packed map.
        answers: path; its first answer is that of loading.
        load: returns this answer, packed, and what carries orders out.
    """
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    orders = os.fdopen(os.dup(0), encoding="utf-8")
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123 - a device: what the adapter runs has no standard input
        os.dup2(nothing.fileno(), 0)
    first, play = load(packed.decode(Path(asked).read_bytes()))
    _write(answers, [first, b""])
    for line in orders:
        order = packed.decode(Path(f"{asked}.{int(line)}").read_bytes())
        _write(f"{answers}.{int(line)}", itertools.chain(play(order), [b""]))
    _end()


def _write(path: str, answers: Iterable[bytes]) -> None:
    with Path(path).open("wb", buffering=0) as told:
        told.writelines(LENGTH.pack(len(answer)) + answer for answer in answers)


def _end() -> NoReturn:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # a model's threads may go on for ever


def result(value: object) -> bytes:
    """Return an answer, packed."""
    return b"".join(packed.encode({spec.Payload.RESULT: value}))


def failed(error: BaseException, **more: Any) -> bytes:
    """Return an answer that is an error, packed."""
    return b"".join(packed.encode({ERROR: f"{type(error).__name__}: {error}", **more}))
