"""Rules made for one test, in a conformance room of their own, and adapters to run them on."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl.registry import RegisteredEntry as Registered
from xpl_cli.audit.rules import registry
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers

if TYPE_CHECKING:
    import pytest


@dataclass
class Room:
    """A conformance room.

    Attributes:
        folder: where its rules lie.
    """

    folder: Path

    def rule(
        self,
        slug: str,
        body: str,
        *,
        code: str,
        after: tuple[str, ...] = (),
        facts: str = "source",
        folder: str = "static",
        gate: str | None = None,
    ) -> Path:
        """Write a rule, a SHOULD, and return its file; `body` is that of its check, `folder` that of its gate."""
        path = self.folder / folder / slug / "rule.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        declaration = f'code="{code}", requirement="XPL-PKG-6", after={after!r}, gate={gate!r}'
        path.write_text(
            f'"""{code}: A rule of a test."""\n\n'
            "from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, NotRun, rule\n\n\n"
            f"@rule({declaration})\ndef check({facts}):\n" + textwrap.indent(textwrap.dedent(body), "    ")
        )
        return path

    def entries(self) -> tuple[registry.RuleEntry, ...]:
        """Return its rules in order of code; one whose code is not ours is an installed package's."""
        found = map(registry.RuleEntry.at, self.folder.glob("*/*/rule.py"))
        source = Registered("xpl.rules", "theirs", "theirs.rules", "theirs 1.0")
        each = (item if item.code.startswith("XPL") else replace(item, source=source) for item in found)
        return tuple(sorted(each, key=lambda entry: entry.code))


def made_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Room:
    """Return an empty room that takes the place of the real one."""
    folder.mkdir()
    room = Room(folder)
    monkeypatch.setattr(registry, "entries", room.entries)
    return room


def made_adapter(folder: Path, **answers: Any) -> Path:
    """Write a fresh scaffold and return its folder."""
    adapter.write(adapter.render(AdapterAnswers(**{**adapter.defaults(), "name": folder.name, **answers})), folder)
    return folder
