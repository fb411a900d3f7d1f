r"""Output: data on stdout or in the file of `--output`, everything else on stderr.

Names, messages and evidence are untrusted. Control characters, direction marks and characters without encoding are
escaped in all output, such as `\u001b`; that form is also valid in JSON.
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
    """The destination of data, and whether there was any.

    Attributes:
        stream: gets the data; None for the current stdout.
        is_used: whether there was any.
    """

    stream: StringIO | None = None
    is_used = False


_output = _AnswerOutput()


def open_streams() -> None:
    """Prepare the standard streams of this process.

    Closed streams are opened on /dev/null: otherwise the next file or connection would get their number, and the
    output. Characters that the locale cannot encode are escaped as in JSON.
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
        with contextlib.suppress(OSError):  # its buffer was replaced
            sys.stdout.reconfigure(errors="written-out")


def _escape_unencodable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    pairs = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass")
    units = (int.from_bytes(pairs[index : index + 2], "big") for index in range(0, len(pairs), 2))
    return "".join(f"\\u{unit:04x}" for unit in units), error.end


def data(text: str) -> None:
    """Write data to the output."""
    data_with_colours(escape_controls(text))


def data_with_colours(text: str) -> None:
    """Write data with terminal colours; untrusted text in it has to be escaped already."""
    _output.is_used = True
    stream = _stream()
    try:
        stream.write(text if text.endswith("\n") else text + "\n")
        stream.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the rest is not written again at exit
        message = f"the answer cannot be written to standard output: {error.strerror}"
        raise UserError(message, code=ExitCode.NOT_RUN) from None


def data_json(value: object) -> None:
    """Write an answer as JSON."""
    data(json.dumps(value, indent=2, ensure_ascii=False))


def answer(schema: str, body: Mapping[str, object], following: Sequence[str] = ()) -> None:
    """Write an answer as a JSON object that names its schema.

    Args:
        schema: its name in `xpl answers`.
        body: all further keys.
        following: exact next commands.
    """
    data_json({"schema": schema, **body, "next": list(following)})


def rich(renderable: RenderableType) -> None:
    """Write a renderable: in colour on a terminal, plain and unwrapped elsewhere."""
    from rich.console import Console

    _output.is_used = True
    stream = _stream()
    console = Console(file=stream, highlight=False, soft_wrap=not stream.isatty())
    console.print(renderable)


def note(text: str) -> None:
    """Write a note to stderr."""
    sys.stderr.write(f"{without_workflow_commands(escape_controls(text))}\n")
    sys.stderr.flush()


def has_answered() -> bool:
    """Tell whether data was written."""
    return _output.is_used


@contextlib.contextmanager
def output_to(path: Path | None) -> Iterator[None]:
    """Write the data of a `with` block to a file, whole or not at all; None leaves it on stdout.

    Raises:
        UserError: at the start if the file cannot be written; at the end if writing fails.
    """
    if path is None:
        yield
        return
    import typer

    from xpl_cli.basics import output

    output.check(path)
    _output.stream = buffer = StringIO()
    exit_request: typer.Exit | None = None
    try:
        yield
    except typer.Exit as exited:  # an exit code does not discard the data
        exit_request = exited
    finally:
        _output.stream = None
    output.write(path, buffer.getvalue())
    note(f"wrote {path}")
    if exit_request is not None:
        raise exit_request


def _stream() -> TextIO:
    return sys.stdout if _output.stream is None else _output.stream
