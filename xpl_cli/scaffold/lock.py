"""What a package keeps of how it was made, below `.xpl/`: the lock, and its files as they were rendered.

Generated files stay as they were rendered. All others are the author's, who started from what was rendered: an update
merges into them what the template changed since. Free files are the author's alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import yaml

from xpl import json_text
from xpl_cli.basics.errors import UserError
from xpl_cli.scaffold.template import as_yaml
from xpl_cli.standard import spec
from xpl_cli.standard.schemas import FOLDER

if TYPE_CHECKING:
    from pathlib import Path

PATH = f"{FOLDER}/lock.yml"
RENDERED = f"{FOLDER}/rendered.json"
"""The texts that the template gave, by file: what an author's file is compared with when the template has changed."""

_TEXT = """\
# Kept by xpl, which updates this package by it. Only `free` is yours to write: a file that is named there is never
# touched.
{origin}
generated: # as rendered; `xpl audit --fix` brings them back
{generated}
{free}
"""


@dataclass(frozen=True)
class Lock:
    """What a package was rendered from.

    Attributes:
        template: name of the template: the kind of package.
        answers: what its author chose.
        generated: file to digest of what was rendered.
        free: files that the author took over.
    """

    template: str
    answers: Mapping[str, Any]
    generated: Mapping[str, str] = field(default_factory=dict)
    free: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the file's text."""
        return _TEXT.format(
            origin=as_yaml({"template": self.template, "answers": dict(self.answers)}),
            generated="\n".join(f"  {as_yaml(name)}: {kept}" for name, kept in sorted(self.generated.items()))
            or "  {}",
            free=as_yaml({"free": list(self.free)}),
        )


def digest(content: bytes) -> str:
    """Return what the lock keeps of a file's content."""
    return hashlib.sha256(content).hexdigest()


def read(folder: Path) -> Lock | None:
    """Return the lock of a package, None if it was not scaffolded.

    Raises:
        UserError: if it is not a lock any more.
    """
    path = folder / PATH
    return parse(path.read_bytes(), str(path)) if path.is_file() else None


def parse(content: bytes | str, where: str) -> Lock:
    """Return the lock that a text holds.

    Raises:
        UserError: if it does not tell template and answers; `where` names it.
    """
    try:
        told = spec.parse_yaml(content)
        template, answers = told["template"], told["answers"]
        generated = {str(name): str(kept) for name, kept in (told.get("generated") or {}).items()}
        result = Lock(template, answers, generated, tuple(map(str, told.get("free") or ())))
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError):
        raise _not_ours(where) from None
    if not isinstance(template, str) or not isinstance(answers, Mapping):
        raise UserError(f"{where} does not name the template and the answers of the package")
    return result


def read_rendered(folder: Path) -> dict[str, bytes]:
    """Return the files of a package as they were rendered.

    Raises:
        UserError: if nothing tells any more how they were.
    """
    path = folder / RENDERED
    try:
        return parse_rendered(path.read_bytes())
    except (OSError, ValueError, AttributeError):
        raise _not_ours(str(path)) from None


def parse_rendered(content: bytes | str) -> dict[str, bytes]:
    """Return the files that a text of `rendered.json` holds.

    Raises:
        ValueError, AttributeError: if it is another document.
    """
    return {str(name): text.encode() for name, text in json_text.parse(content).items()}


def rendered_text(files: Mapping[str, bytes]) -> bytes:
    """Return the text of `rendered.json` for files."""
    texts = {name: content.decode() for name, content in sorted(files.items())}
    return f"{json.dumps(texts, indent=2, ensure_ascii=False)}\n".encode()


def _not_ours(where: str) -> UserError:
    return UserError(
        f"{where} is not what xpl wrote there, so that nothing can be told of what the package came from",
        hint="bring it back as it was, for example from version control",
    )
