"""Rules made for one test, in a conformance room of their own, and adapters to run them on."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.audit.rules import registry
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import Answers

if TYPE_CHECKING:
    import pytest


@dataclass
class Room:
    """A conformance room.

    Attributes:
        folder: where its rules lie.
    """

    folder: Path

    def rule(self, slug: str, body: str, *, code: str, after: tuple[str, ...] = (), facts: str = "source") -> Path:
        """Write a rule, a SHOULD of the static gate, and return its file; `body` is that of its check."""
        path = self.folder / slug / "rule.py"
        path.parent.mkdir(exist_ok=True)
        declaration = f'code="{code}", slug="{slug}", gate="static", requirement="XPL-PKG-6", after={after!r}'
        path.write_text(
            f'"""{code}: A rule of a test."""\n\n'
            "from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, NotRun, rule\n\n\n"
            f"@rule({declaration})\ndef check({facts}):\n" + textwrap.indent(textwrap.dedent(body), "    ")
        )
        return path

    def entries(self) -> tuple[registry.Entry, ...]:
        """Return its rules in order of code."""
        found = (
            registry.Entry(path.read_text()[3:9], path.parent.name, path) for path in self.folder.glob("*/rule.py")
        )
        return tuple(sorted(found, key=lambda entry: entry.code))


def made_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Room:
    """Return an empty room that takes the place of the real one."""
    folder.mkdir()
    room = Room(folder)
    monkeypatch.setattr(registry, "entries", room.entries)
    return room


def made_adapter(folder: Path) -> Path:
    """Write a fresh scaffold and return its folder."""
    adapter.write(adapter.render(Answers(**{**adapter.defaults(), "name": folder.name})), folder)
    return folder
