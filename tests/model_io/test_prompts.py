"""Templates of instructions, read where they are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from xpl_cli.model_io.prompts import templates

if TYPE_CHECKING:
    from pathlib import Path

CODE = """CONVENTIONS = {{"instruction": "{source}"}}


def answers(config):
    return lambda episode: (f"Task: {{episode.text}}\\n", episode.field("{{side}}_pose"))
"""
AUTHORS = (
    """PLAN = "Plan: {}"


def prompt(text):
    return "What should the robot do to " + text.strip() + "?"
"""
    + "\n" * 40
    + "FAR = 'Far away: {}'\n"
)


@pytest.mark.parametrize(
    ("source", "wanted"),
    [
        ("authors/pipeline.py:5", {"What should the robot do to {instruction}?", "Plan: {instruction}"}),
        ("assumed", set()),
        ("../elsewhere.py:5", set()),
        ("authors/missing.py:5", set()),
    ],
)
def test_templates_are_read_in_the_reference_and_at_its_source(source: str, wanted: set[str], tmp_path: Path) -> None:
    folder = tmp_path / "Foo"
    (folder / "authors").mkdir(parents=True)
    (folder / "reference.py").write_text(CODE.format(source=source))
    (folder / "authors" / "pipeline.py").write_text(AUTHORS)
    (tmp_path / "elsewhere.py").write_text(AUTHORS)
    assert set(templates(folder)) == wanted | {"Task: {instruction}\n"}


def test_without_a_reference_there_are_none(tmp_path: Path) -> None:
    assert templates(tmp_path) == []
    (tmp_path / "reference.py").write_text("def (")
    assert templates(tmp_path) == []
