"""Names of the engine: a class is found by its name alone, and words that the glossary replaces name nothing."""

from __future__ import annotations

import ast
import collections
import re
from typing import TYPE_CHECKING

from tests.support.checkout import ROOT, tracked

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

ENGINE = [path for path in tracked("xpl/**/*.py", "xpl_cli/**/*.py") if path.name != "_spec.py"]
"""All but what is written from the standard, whose names are the standard's."""
ORDINARY = {
    "said",
    "seen",
    "known",
    "given",
    "held",
    "kept",
    "orders",
    "lane",
    "place",
    "show",
    "ask",
    "play",
    "thing",
    "signals",
}
"""Words of the glossary's left column that are also ordinary words of code, such as the order of axes."""


def _named(path: Path) -> Iterator[tuple[str, str]]:
    """Yield what a module defines: kind and name."""
    yield "module", path.stem
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef):
            yield "class", node.name
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield "function", node.name


def test_a_class_name_is_unique() -> None:
    places = collections.defaultdict(list)
    for path in ENGINE:
        for kind, name in _named(path):
            if kind == "class":
                places[name].append(str(path.relative_to(ROOT)))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_words_that_the_glossary_replaces_name_nothing() -> None:
    table = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").partition("## Words that are not used\n")[2]
    cells = [line.split("|")[1] for line in table.partition("\n## ")[0].splitlines()[4:] if line.startswith("|")]
    banned = {word for cell in cells for word in re.findall(r"(?:^|, )([a-z]+)(?= *(?:,|$))", cell.strip())} - ORDINARY
    assert {"told", "found", "contest", "spoilt", "desk", "errand"} <= banned
    wrong = []
    for path in ENGINE:
        for kind, name in _named(path):
            words = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().replace("not_found", ""))
            if banned & set(words):
                wrong.append(f"{path.relative_to(ROOT)}: {kind} {name}")
    assert wrong == []
