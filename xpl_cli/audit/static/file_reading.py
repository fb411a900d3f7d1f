"""Reads one file of a package that may hold anything: a pipe, a link that leads away, bytes in no encoding."""

from __future__ import annotations

import codecs
import io
import os
import stat
import tokenize
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.rules.model import NotRun
from xpl_cli.basics.yaml import text as yaml_text

if TYPE_CHECKING:
    from pathlib import Path

_ASCII: Final = bytes(range(0x20, 0x7F)).replace(b"\\", b"") + b"\t\n\r\\x41~{+AGE-.xn--4ca"
SIZE_LIMIT: Final = 2 * 1024 * 1024
"""Files beyond this many bytes are data, not source."""

_TEXT: Final = frozenset((".py", ".sh", ".yml", ".yaml", ".md", ".toml", ".txt", ".cfg", ".json"))
_DOCUMENTS: Final = frozenset(("authors", "changelog", "citation", "contributing", "license", "notice", "readme"))


def is_text(name: str) -> bool:
    """Tell whether a file is text by its suffix."""
    return PurePath(name).suffix in _TEXT


def is_document(name: str) -> bool:
    """Tell whether a file is for readers only; of a package that acts by one all the same, the answers show it."""
    stem, _, suffix = name.rpartition("/")[2].lower().rpartition(".")
    return suffix == "md" or (suffix == "txt" and stem in _DOCUMENTS)


@dataclass(frozen=True)
class FileText:
    """What a file holds.

    Attributes:
        content: its bytes.
        text: what they say; undecodable ones are replaced.
        encoding_error: why Python refuses them, if it is a Python file; None if it takes them.
    """

    content: bytes
    text: str
    encoding_error: str | None


def read_text(package: Path, name: str) -> FileText:
    """Return what a file of a package holds.

    Args:
        package: the package's folder, resolved.
        name: the file, relative to the folder.

    Raises:
        NotRun: if there is no such file or it may not be read, if it is too large, or lies outside of the package.
    """
    try:
        if resolve_inside(package, name) is None and (package / name).is_file():
            raise NotRun(f"{name} is a link that leads out of the package, and is not followed")
        # A pipe that took the file's place meanwhile is opened without waiting for its writer.
        handle = os.open(package / name, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    except PermissionError as error:
        raise NotRun(f"{name} may not be read: {error.strerror}") from None
    except (OSError, ValueError):  # gone, a loop of links, or a name that no file can have
        raise NotRun(f"there is no {name}") from None
    try:
        with os.fdopen(handle, "rb") as stream:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise NotRun(f"there is no {name}")
            data = stream.read(SIZE_LIMIT + 1)
    except OSError as error:
        raise NotRun(f"{name} cannot be read: {error.strerror or error}") from None
    if len(data) > SIZE_LIMIT:
        raise NotRun(f"{name} is larger than {SIZE_LIMIT} bytes")
    return FileText(data, *decode_text(data, python=name.endswith(".py")))


def resolve_inside(package: Path, name: str) -> str | None:
    """Return a file's name in its package with all links followed; None if it is no file, or lies elsewhere.

    Two names of one file give one answer, so that a folder that links to itself has no more files than it holds.
    """
    try:
        file = (package / name).resolve()
        return file.relative_to(package).as_posix() if file.is_relative_to(package) and file.is_file() else None
    except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
        return None


def decode_text(data: bytes, *, python: bool) -> tuple[str, str | None]:
    """Return the text of a file, and why Python would refuse it; undecodable bytes are replaced.

    Args:
        data: what the file holds.
        python: whether the encoding that a Python file declares counts.
    """
    encoding, problem = "utf-8", None
    if python:
        try:
            encoding, _ = tokenize.detect_encoding(io.BytesIO(data).readline)
            _require_ascii(encoding)
            data.decode(codecs.lookup(encoding).name)
        except (SyntaxError, LookupError) as error:
            encoding, problem = "utf-8", str(error)
        except UnicodeDecodeError as error:
            line_number = data.count(b"\n", 0, error.start) + 1
            problem = f"byte {error.object[error.start]:#04x} in line {line_number} is not {error.encoding}"
    text = data.decode(encoding, errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").removeprefix("\ufeff"), problem


def _require_ascii(encoding: str) -> None:
    """Refuse an encoding that does not leave ASCII as it is: punycode, idna, escapes and UTF-7 hide what people read.

    Some of those cannot replace what does not decode, either, or take a time that grows with the square of the size.

    Raises:
        LookupError: if it is one of them, or none at all.
    """
    try:
        if _ASCII.decode(encoding, errors="replace") == _ASCII.decode("ascii"):
            return
    except UnicodeError:
        pass
    raise LookupError(f"{encoding} is no encoding for source: in it, ASCII stands for something else")


def parse_yaml(content: bytes) -> tuple[yaml_text.YamlDocument, tuple[str, int, int] | None]:
    """Return what YAML holds, and why it does not parse, with line and column."""
    import yaml

    nothing = yaml_text.YamlDocument(None, None)
    try:
        return yaml_text.read(content), None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        return nothing, (str(error.problem or error), (mark.line + 1 if mark else 1), (mark.column + 1 if mark else 1))
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        return nothing, (" ".join(str(error).split()), 1, 1)
