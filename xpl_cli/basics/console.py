r"""Output: data on stdout or in the file that was asked for, everything else on stderr.

Names, messages and evidence may come from anybody. What would steer a terminal, turn the direction of writing or cannot
be encoded is written out as `\u001b`, in everything that passes here; that form is also valid in JSON.
"""

from __future__ import annotations

import codecs
import contextlib
import json
import os
import sys
from io import StringIO, TextIOWrapper
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.untrusted import escape_controls, without_workflow_commands

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import TextIO

    from rich.console import RenderableType


class _AnswerOutput:
    """Where data goes, and whether any went.

    Attributes:
        stream: takes data; None for stdout, as it is at that time.
        is_used: whether there was any.
    """

    stream: StringIO | None = None
    is_used = False


_output = _AnswerOutput()


def open_streams() -> None:
    """Prepare the standard streams of this process for whatever is written there.

    Those that are closed lead nowhere: otherwise the next file or connection would get their number, and what is
    printed. What the locale has no letters for is written out as in JSON.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            os.dup2(nowhere, number)
            if nowhere > number:
                os.close(nowhere)
            setattr(sys, name, open(number, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: PTH123, SIM115
    codecs.register_error("written-out", _escape_unencodable)
    if isinstance(sys.stdout, TextIOWrapper):
        with contextlib.suppress(OSError):  # what lay below it when it was made was exchanged for something else
            sys.stdout.reconfigure(errors="written-out")


def _escape_unencodable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    pairs = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass")
    units = (int.from_bytes(pairs[place : place + 2], "big") for place in range(0, len(pairs), 2))
    return "".join(f"\\u{unit:04x}" for unit in units), error.end


def data(text: str) -> None:
    """Write an answer."""
    data_with_colours(escape_controls(text))


def data_with_colours(text: str) -> None:
    """Write an answer with colours for a terminal; what strangers gave to it has to be harmless already."""
    _output.is_used = True
    stream = _stream()
    try:
        stream.write(text if text.endswith("\n") else text + "\n")
        stream.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what was not written is not tried again at the end
        told = f"the answer cannot be written to standard output: {error.strerror}"
        raise UserError(told, code=ExitCode.NOT_RUN) from None


def data_json(value: object) -> None:
    """Write an answer as JSON."""
    data(json.dumps(value, indent=2, ensure_ascii=False))


def answer(schema: str, body: Mapping[str, object], following: Sequence[str] = ()) -> None:
    """Write an answer as a JSON object that names its schema.

    Args:
        schema: its name in `xpl answers`.
        body: all further keys.
        following: exact commands that are worth running next.
    """
    data_json({"schema": schema, **body, "next": list(following)})


def rich(renderable: RenderableType) -> None:
    """Write an answer for people: in colour on a terminal, plain and unwrapped elsewhere."""
    from rich.console import Console

    _output.is_used = True
    stream = _stream()
    console = Console(file=stream, highlight=False, soft_wrap=not stream.isatty())
    console.print(renderable)


def note(text: str) -> None:
    """Write a remark to stderr."""
    sys.stderr.write(f"{without_workflow_commands(escape_controls(text))}\n")
    sys.stderr.flush()


def has_answered() -> bool:
    """Tell whether data was written."""
    return _output.is_used


@contextlib.contextmanager
def output_to(path: Path | None) -> Iterator[None]:
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
