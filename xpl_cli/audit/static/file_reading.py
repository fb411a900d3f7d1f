"""Read one file of an untrusted package: it may be a pipe, a link to outside, or bytes in no encoding."""

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
"""Files larger than this, in bytes, are data and not source."""

_TEXT: Final = frozenset((".py", ".sh", ".yml", ".yaml", ".md", ".toml", ".txt", ".cfg", ".json"))
_DOCUMENTS: Final = frozenset(("authors", "changelog", "citation", "contributing", "license", "notice", "readme"))


def is_text(name: str) -> bool:
    """Return whether a file is text by its suffix."""
    return PurePath(name).suffix in _TEXT


def is_document(name: str) -> bool:
    """Return whether a file is documentation, which does not affect the adapter's behaviour."""
    stem, _, suffix = name.rpartition("/")[2].lower().rpartition(".")
    return suffix == "md" or (suffix == "txt" and stem in _DOCUMENTS)


@dataclass(frozen=True)
class FileText:
    """The content of a file.

    Attributes:
        content: its bytes.
        text: the decoded text; undecodable bytes are replaced.
        encoding_error: why Python cannot decode them, if it is a Python file; else None.
    """

    content: bytes
    text: str
    encoding_error: str | None


def read_text(package: Path, name: str) -> FileText:
    """Return the content of a file of a package.

    Args:
        package: the package's folder, resolved.
        name: the file, relative to the folder.

    Raises:
        NotRun: if the file does not exist, may not be read, is too large, or is outside of the package.
    """
    try:
        if resolve_inside(package, name) is None and (package / name).is_file():
            raise NotRun(f"{name} is a link to outside the package, and is not followed")
        # If a pipe replaced the file meanwhile, opening it must not wait for a writer.
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
    """Return a file's name in its package with all links followed; None if it is no file, or outside.

    Two names of one file give one result, so that a folder that links to itself is not counted twice.
    """
    inside = f"{package}{os.sep}"
    path = os.path.join(package, name)  # noqa: PTH118 - as below; an absolute name stays what it is
    try:
        if not os.path.isfile(path):  # noqa: PTH113 - most imports are of no file here, and a Path takes longer
            return None
        real = os.path.realpath(path)  # noqa: PTH - likewise
    except (OSError, ValueError):  # a loop of links, a name that no file can have
        return None
    return real.removeprefix(inside).replace(os.sep, "/") if real.startswith(inside) else None


def decode_text(data: bytes, *, python: bool) -> tuple[str, str | None]:
    """Return the text of a file, and why Python could not decode it; undecodable bytes are replaced.

    Args:
        data: the file's bytes.
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
    """Refuse an encoding that does not preserve ASCII: punycode, idna, escapes and UTF-7 hide code from readers.

    Some of those cannot replace what does not decode, either, or take a time that grows with the square of the size.

    Raises:
        LookupError: if it is one of them, or none at all.
    """
    try:
        if _ASCII.decode(encoding, errors="replace") == _ASCII.decode("ascii"):
            return
    except UnicodeError:
        pass
    raise LookupError(f"{encoding} is no encoding for source: it does not preserve ASCII")


def parse_yaml(content: bytes) -> tuple[yaml_text.YamlDocument, tuple[str, int, int] | None]:
    """Return a YAML document, and why it does not parse, with line and column."""
    import yaml

    nothing = yaml_text.YamlDocument(None, None)
    try:
        return yaml_text.read(content), None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        return nothing, (str(error.problem or error), (mark.line + 1 if mark else 1), (mark.column + 1 if mark else 1))
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        return nothing, (" ".join(str(error).split()), 1, 1)
