"""What is said of errors: text that can always be sent, whatever an adapter or a peer put into it. Standard library.

An exception's text may hold lone surrogates, which no encoder takes; it may be longer than a frame; and making it runs
code of the adapter, which may raise. Everything that tells somebody of an error goes through here.
"""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from typing import Any

SENTENCE = 4096
"""Characters of what a client is told of an error."""
TRACEBACK = 1 << 16
"""Characters of a traceback in the log."""
_LEVELS = 8
_ENTRIES = 64


def sendable(text: str, longest: int = SENTENCE) -> str:
    """Return a text that every encoder takes: lone surrogates are written out, what is too long loses its middle."""
    if len(text) > longest:
        half = (longest - 40) // 2
        text = f"{text[:half]} ... {len(text) - 2 * half} characters ... {text[-half:]}"
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def text_of(value: Any) -> str:
    """Return `str(value)`, also of an object that raises when it is asked for it."""
    try:
        return sendable(str(value))
    except BaseException as error:  # noqa: BLE001 - code of an adapter, which may raise anything
        return f"<a {sendable(type(value).__name__, 80)} whose text cannot be had: {type(error).__name__}>"


def describe(error: BaseException, frames: Any = None) -> dict[str, str]:
    """Return type, message and traceback of an exception.

    Args:
        error: the exception.
        frames: where its traceback begins; all of it by default.
    """
    kind = sendable(type(error).__name__, 200)
    message = text_of(error)
    if isinstance(error, SystemExit):
        message = f"the adapter called sys.exit({_shown(error.code)})"
    try:
        told = "".join(traceback.format_exception(type(error), error, frames or error.__traceback__))
    except BaseException as problem:  # noqa: BLE001 - as above
        told = f"{kind}: {message}\n(its traceback cannot be had: {type(problem).__name__})\n"
    return {"type": kind, "message": message or kind, "traceback": sendable(told, TRACEBACK)}


def sendable_tree(value: Any, level: int = 0) -> Any:
    """Return a value of maps, lists, text and numbers with all its text sendable; anything else becomes text."""
    if value is None or isinstance(value, (bool, float)) or (type(value) is int and -(1 << 63) <= value < 1 << 63):
        return value
    if isinstance(value, str):
        return sendable(value)
    if level < _LEVELS and isinstance(value, Mapping):
        return {text_of(key): sendable_tree(item, level + 1) for key, item in list(value.items())[:_ENTRIES]}
    if level < _LEVELS and isinstance(value, (list, tuple)):
        return [sendable_tree(item, level + 1) for item in value[:_ENTRIES]]
    return text_of(value)


def _shown(value: Any) -> str:
    try:
        return sendable(repr(value))
    except BaseException as error:  # noqa: BLE001 - as above
        return f"<its text cannot be had: {type(error).__name__}>"
