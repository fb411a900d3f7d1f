"""What documents, templates and our own packages import is there, and is imported first thing."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from typing import TYPE_CHECKING

import pytest

import xpl
from tests.support.checkout import ROOT, tracked

if TYPE_CHECKING:
    from collections.abc import Iterator

DOCUMENTS = ("README.md", "CONTRIBUTING.md", "docs/**", "templates/**", ".agents/skills/**", "envs/**", "policy/**")
EXAMPLES = "docs/rules/"
"""Pages that show imports of names that are not there."""
TEXTS = (".md", ".py", ".jinja", ".yml", ".sh")


def named(text: str) -> Iterator[tuple[str, str]]:
    """Yield every module of ours and public name in it that a text imports, or of the SDK writes out as code."""
    for module, wrapped, plain in re.findall(r"from (xpl(?:_cli)?[.\w]*) import (?:\(([\w\s,]+)\)|([\w ,]+))", text):
        words = [name.partition(" as ")[0].strip() for name in (wrapped or plain).split(",")]
        yield from ((module, word) for word in words if word and not word.startswith("_"))
    for path in re.findall(r"`xpl\.([\w.]+)", text):
        *folders, name = f"xpl.{path}".rstrip(".").split(".")
        if _is_module(".".join(folders)) and (len(folders) > 1 or name in xpl.__all__):
            yield ".".join(folders), name


def _is_module(name: str) -> bool:
    place = ROOT / name.replace(".", "/")
    return place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()


def documented() -> dict[str, set[str]]:
    """Return what documents import or name: per module the names in it."""
    found = defaultdict(set)
    for path in tracked(*DOCUMENTS):
        if path.suffix in TEXTS and not path.relative_to(ROOT).as_posix().startswith(EXAMPLES):
            for module, name in named(path.read_text(encoding="utf-8", errors="replace")):
                found[module].add(name)
    return dict(found)


PUBLIC = documented()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("module", sorted(PUBLIC))
def test_what_documents_name_is_imported_first_thing(module: str) -> None:
    command = [sys.executable, "-c", f"from {module} import {', '.join(sorted(PUBLIC[module]))}"]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
