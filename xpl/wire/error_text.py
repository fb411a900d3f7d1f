"""Text of errors that can always be sent, whatever an adapter or a peer put into it. Standard library only.

An exception's text may hold lone surrogates, which no encoder accepts; it may be longer than a frame; and `str` runs
code of the adapter, which may raise. Every report of an error uses this module.
"""

from __future__ import annotations

import linecache
import os
import stat
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

SENTENCE = 4096
"""Most characters of an error that is sent to a client."""
TRACEBACK = 1 << 16
"""Characters of a traceback in the log."""
_LEVELS = 8
_ENTRIES = 64
_CAUSES = 64
"""Most exceptions that a traceback describes: causes, contexts and members of groups together."""
_OWN_FRAMES = 16
_INSTALLED = "site-packages"
_SOURCE = 1 << 22
"""Bytes of the largest file from which a traceback shows lines."""


def sendable(text: str, longest: int = SENTENCE) -> str:
    """Return a text that every encoder accepts: lone surrogates are escaped, a long text loses its middle."""
    if len(text) > longest:
        half = (longest - 40) // 2
        text = f"{text[:half]} ... {len(text) - 2 * half} characters ... {text[-half:]}"
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def visible(text: str) -> str:
    r"""Return a peer's text for a terminal: characters that are not printable are escaped, such as `\x1b`.

    Line ends and tabs stay; a text longer than `TRACEBACK` loses its middle.
    """
    text = sendable(text, TRACEBACK)
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() or char in "\n\t" else _written_out(char) for char in text)


def _written_out(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")


def text_of(value: object) -> str:
    """Return `str(value)`, also of an object whose `__str__` raises."""
    try:
        return sendable(str(value))
    except BaseException as error:  # noqa: BLE001 - code of an adapter, which may raise anything
        return f"<a {sendable(name_of(value), 80)} whose text cannot be had: {name_of(error)}>"


def name_of(value: object) -> str:
    """Return the name of an object's class, also of one that hides it."""
    name: str = type.__dict__["__name__"].__get__(type(value))
    return sendable(name, 200)


def describe(error: BaseException, frames: object = None) -> dict[str, str]:
    """Return type, message and traceback of an exception.

    Args:
        error: the exception.
        frames: first frame of the traceback; all of it by default.
    """
    kind = name_of(error)
    message = text_of(error)
    if isinstance(error, SystemExit):
        message = f"the adapter called sys.exit({_printable(error.code)})"
    try:
        trace_text = _traceback(error, frames or error.__traceback__, f"{kind}: {message}\n")
    except BaseException as problem:  # noqa: BLE001 - as above
        trace_text = f"{kind}: {message}\n(its traceback cannot be had: {name_of(problem)})\n"
    return {"type": kind, "message": message or kind, "traceback": sendable(trace_text, TRACEBACK)}


def own_frames(error: BaseException, folder: Path) -> list[list[Any]]:
    """Return the frames of a folder's own files in a traceback, innermost first.

    Args:
        error: the exception.
        folder: the folder; files of an environment that is installed in it do not count.

    Returns:
        file relative to the folder with forward slashes, line, and name of the function; at most 16 of them.
    """
    roots = [f"{root}{os.sep}" for root in (folder, os.path.realpath(folder))]
    own: list[list[Any]] = []
    for frame, line in traceback.walk_tb(error.__traceback__):
        name = frame.f_code.co_filename
        file = next((name[len(root) :] for root in roots if name.startswith(root)), None)
        if file is not None and _INSTALLED not in (parts := Path(file).parts):
            own.append([sendable("/".join(parts)), line, sendable(frame.f_code.co_name)])
    return own[: -_OWN_FRAMES - 1 : -1]


def _traceback(error: BaseException, frames: Any, last: str) -> str:
    """Return a traceback: with all causes if these are few, else of the exception alone, with `last` as its last line.

    The standard library visits all of them before it formats one, and reads each source file to its end.
    """
    related = _related(error)
    for one in related:
        _hide_odd_sources(one.__traceback__)
    _hide_odd_sources(frames)
    if len(related) <= _CAUSES:
        return "".join(traceback.format_exception(type(error), error, frames))
    head = "Traceback (most recent call last; its causes and members are too many to list):\n"
    return head + "".join(traceback.format_tb(frames)) + last


def _related(error: BaseException) -> list[BaseException]:
    """Return an exception, each of its causes and contexts once, and members of groups each time; bounded.

    The standard library, too, formats a repeated cause once, and a repeated member each time.
    """
    related: list[BaseException] = []
    visited, new = {id(error)}, [error]
    while new and len(related) <= _CAUSES:
        one = new.pop()
        related.append(one)
        new += [member for member in getattr(one, "exceptions", ())[: _CAUSES + 1] if isinstance(member, BaseException)]
        for other in (one.__cause__, one.__context__):
            if other is not None and id(other) not in visited:
                visited.add(id(other))
                new.append(other)
    return related


def _hide_odd_sources(frames: TracebackType | None) -> None:
    """Prevent `linecache` from reading source lines of very large files, and of anything but plain files."""
    while frames is not None:
        name = frames.tb_frame.f_code.co_filename
        try:
            found = os.stat(name)  # noqa: PTH116 - a name that is no valid path raises here too
            is_odd = not stat.S_ISREG(found.st_mode) or found.st_size > _SOURCE
        except (OSError, ValueError):
            is_odd = False
        if is_odd:
            linecache.cache[name] = (0, None, [], name)
        frames = frames.tb_next


def sendable_tree(value: object, level: int = 0) -> Any:
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


def _printable(value: object) -> str:
    try:
        return sendable(repr(value))
    except BaseException as error:  # noqa: BLE001 - as above
        return f"<its text cannot be had: {name_of(error)}>"
