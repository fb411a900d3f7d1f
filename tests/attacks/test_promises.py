"""The list of promises: every sentence of docs/security.md has attacks that tried it, and every attack a promise."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import yaml

from tests.support.checkout import ROOT

HERE = Path(__file__).parent
LIST = yaml.safe_load((HERE / "promises.yml").read_text("utf-8"))
ATTACKS = [name for entry in LIST for name in entry["attacks"]]


def _sentences() -> list[str]:
    """Return what the table of the page promises."""
    page = (ROOT / "docs/security.md").read_text("utf-8").split("## Promises by input")[1].split("## ")[0]
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")][2:]
    return [sentence for row in rows for sentence in re.split(r"(?<=[.]) (?=[A-Z])", row[2])]


def test_every_promise_is_tried() -> None:
    sentences = _sentences()
    assert len(sentences) > 20
    tried = {entry["promise"]: [one for one in sentences if entry["promise"] in one] for entry in LIST}
    assert {promise: found for promise, found in tried.items() if len(found) != 1} == {}
    assert [one for one in sentences if [one] not in tried.values()] == []


def test_every_attack_is_one_of_a_promise() -> None:
    for name in ATTACKS:
        file, _, test = name.partition("::")
        tree = ast.parse((HERE / file).read_text("utf-8"))
        assert not test or any(isinstance(node, ast.FunctionDef) and node.name == test for node in tree.body), name
    files = {path.name for path in HERE.glob("test_*.py")} - {Path(__file__).name}
    assert files - {name.partition("::")[0] for name in ATTACKS} == set()
