"""The record of how a package was rendered, below `.xpl/`: the lockfile, and the rendered files.

Generated files stay as rendered. All others belong to the author: an update merges the template's changes into them.
Files listed under `free` are never changed.
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
"""The rendered files: the base of the three-way merge when the template changes."""

_TEXT = """\
# Written by xpl, which updates this package with it. Edit only `free`: files listed there are never changed.
{origin}
generated: # digests as rendered; `xpl audit --fix` restores the files
{generated}
{free}
"""


@dataclass(frozen=True)
class Lock:
    """The template and answers that a package was rendered from.

    Attributes:
        template: name of the template: the kind of package.
        answers: the author's choices.
        generated: digest of each generated file.
        free: files that the author took over.
    """

    template: str
    answers: Mapping[str, Any]
    generated: Mapping[str, str] = field(default_factory=dict)
    free: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the text of the lockfile."""
        return _TEXT.format(
            origin=as_yaml({"template": self.template, "answers": dict(self.answers)}),
            generated="\n".join(f"  {as_yaml(name)}: {value}" for name, value in sorted(self.generated.items()))
            or "  {}",
            free=as_yaml({"free": list(self.free)}),
        )


def digest(content: bytes) -> str:
    """Return the digest of a file's content."""
    return hashlib.sha256(content).hexdigest()


def read(folder: Path) -> Lock | None:
    """Read the lockfile of a package; None if it was not scaffolded.

    Raises:
        UserError: the file is damaged.
    """
    path = folder / PATH
    return parse(path.read_bytes(), str(path)) if path.is_file() else None


def parse(content: bytes | str, where: str) -> Lock:
    """Parse a lockfile.

    Raises:
        UserError: it has no template and answers; `where` is its name in the message.
    """
    try:
        document = spec.parse_yaml(content)
        template, answers = document["template"], document["answers"]
        generated = {str(name): str(value) for name, value in (document.get("generated") or {}).items()}
        result = Lock(template, answers, generated, tuple(map(str, document.get("free") or ())))
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError):
        raise _damaged_lock(where) from None
    if not isinstance(template, str) or not isinstance(answers, Mapping):
        raise UserError(f"{where} does not name the template and the answers of the package")
    return result


def read_rendered(folder: Path) -> dict[str, bytes]:
    """Read the rendered files of a package.

    Raises:
        UserError: the record is missing or damaged.
    """
    path = folder / RENDERED
    try:
        return parse_rendered(path.read_bytes())
    except (OSError, ValueError, AttributeError):
        raise _damaged_lock(str(path)) from None


def parse_rendered(content: bytes | str) -> dict[str, bytes]:
    """Parse `rendered.json`.

    Raises:
        ValueError, AttributeError: it is another document.
    """
    return {str(name): text.encode() for name, text in json_text.parse(content).items()}


def rendered_text(files: Mapping[str, bytes]) -> bytes:
    """Return `rendered.json` for files."""
    texts = {name: content.decode() for name, content in sorted(files.items())}
    return f"{json.dumps(texts, indent=2, ensure_ascii=False)}\n".encode()


def _damaged_lock(where: str) -> UserError:
    return UserError(
        f"{where} is damaged: the template of the package is unknown",
        hint="restore it, for example from version control",
    )
