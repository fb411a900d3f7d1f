r"""Output: data on stdout or in the file that was asked for, everything else on stderr.

Names, messages and evidence may come from anybody. What would steer a terminal, turn the direction of writing or cannot
be encoded is written out as `\u001b`, in everything that passes here; that form is also valid in JSON.
"""

from __future__ import annotations

import contextlib
import json
import sys
from io import StringIO
from typing import TYPE_CHECKING, Any

from xpl_cli.basics.strangers import harmless, unheard

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import TextIO


class _Output:
    """Where data goes, and whether any went.

    Attributes:
        stream: takes data; None for stdout, as it is at that time.
        is_used: whether there was any.
    """

    stream: StringIO | None = None
    is_used = False


_output = _Output()


def data(text: str) -> None:
    """Write an answer."""
    painted(harmless(text))


def painted(text: str) -> None:
    """Write an answer with colours for a terminal; what strangers gave to it has to be harmless already."""
    _output.is_used = True
    stream = _stream()
    stream.write(text if text.endswith("\n") else text + "\n")
    stream.flush()


def data_json(value: Any) -> None:
    """Write an answer as JSON."""
    data(json.dumps(value, indent=2, ensure_ascii=False))


def answer(schema: str, body: Mapping[str, Any], following: Sequence[str] = ()) -> None:
    """Write an answer as a JSON object that names its schema.

    Args:
        schema: its name in `xpl answers`.
        body: all further keys.
        following: exact commands that are worth running next.
    """
    data_json({"schema": schema, **body, "next": list(following)})


def rich(renderable: Any) -> None:
    """Write an answer for people: in colour on a terminal, plain and unwrapped elsewhere."""
    from rich.console import Console

    _output.is_used = True
    stream = _stream()
    console = Console(file=stream, highlight=False, soft_wrap=not stream.isatty())
    console.print(renderable)


def note(text: str) -> None:
    """Write a remark to stderr."""
    sys.stderr.write(f"{unheard(harmless(text))}\n")
    sys.stderr.flush()


def has_answered() -> bool:
    """Tell whether data was written."""
    return _output.is_used


@contextlib.contextmanager
def into(path: Path | None) -> Iterator[None]:
    """Write the data of a `with` block to a file, whole or not at all; None leaves it on stdout.

    Raises:
        UserError: before anything is done, if no file can be written there; after it, if it cannot after all.
    """
    if path is None:
        yield
        return
    import typer

    from xpl_cli.basics import output

    output.check(path)
    _output.stream = kept = StringIO()
    end: typer.Exit | None = None
    try:
        yield
    except typer.Exit as exited:  # an end like any other: findings are data
        end = exited
    finally:
        _output.stream = None
    output.write(path, kept.getvalue())
    note(f"wrote {path}")
    if end is not None:
        raise end


def _stream() -> TextIO:
    return sys.stdout if _output.stream is None else _output.stream
