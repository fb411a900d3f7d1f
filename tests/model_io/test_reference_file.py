"""reference.py is read without being run: its conventions, their sources, and what it imports."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from xpl_cli.basics.errors import UserError
from xpl_cli.model_io import reference_file

if TYPE_CHECKING:
    from pathlib import Path

TEXT = '''"""Answers as the authors do."""
import importlib
import numpy as np
from .authors import transforms

CONVENTIONS = {
    "image_channels": "authors/transforms.py:41",
    "gripper": "assumed: the paper does not say",
    "rotation": " Assumed ",
    "chunk": "",
}


def answers(config):
    from xpl import rotation
    importlib.import_module("Foo.model")
    open("policy.yml")
'''


def test_conventions_and_what_is_assumed() -> None:
    parsed = reference_file.parse(TEXT)
    assert {name: source.text for name, source in parsed.conventions.items()} == {
        "image_channels": "authors/transforms.py:41",
        "gripper": "assumed: the paper does not say",
        "rotation": " Assumed ",
        "chunk": "",
    }
    assert parsed.assumed == ("gripper", "rotation", "chunk")
    assert parsed.conventions["gripper"].location.line == 8
    assert (parsed.defines_answers, parsed.problems) == (True, ())
    assert "policy.yml" in [text for text, _ in parsed.texts]
    assert not any("Answers as" in text for text, _ in parsed.texts)


def test_imports_wherever_they_stand() -> None:
    parsed = reference_file.parse(TEXT).imports
    assert [(item.module, item.level, item.location.line) for item in parsed] == [
        ("importlib", 0, 2),
        ("numpy", 0, 3),
        ("authors", 1, 4),
        ("xpl", 0, 15),
        ("Foo.model", 0, 16),
    ]
    assert [item.module for item in parsed if item.takes_sdk] == ["xpl"]
    assert [item.module for item in parsed if item.takes_adapter("Foo")] == ["Foo.model"]


@pytest.mark.parametrize(
    ("line", "taken"),
    [
        ("from .model import Model", True),
        ("from . import model", True),
        ("from policy.Foo import model", True),
        ("import XPolicyLab.policy.Foo.model", True),
        ("from .authors.model import Net", False),
        ("from ..model import Net", False),
        ("import model", False),
        ("from robomimic.model import base", False),
    ],
)
def test_which_imports_take_the_adapter(line: str, taken: bool) -> None:
    (parsed,) = reference_file.parse(line).imports
    assert parsed.takes_adapter("Foo") is taken


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("CONVENTIONS = dict(gripper='assumed')", "no literal map"),
        ("CONVENTIONS = {'colour': 'a.py:1'}", "'colour' is no convention; there are image_channels"),
        (
            "CONVENTIONS = {'history': 'a.py:1'}",
            "no convention any more, but history_length, history_order, history_padding, history_stride are",
        ),
        ("CONVENTIONS = {'gripper': 1}", "source of 'gripper' is no literal text"),
        ("CONVENTIONS = {'gripper': 'a.py:1', 'gripper': 'b.py:1'}", "twice"),
        ("CONVENTIONS = {name: 'a.py:1'}", "no literal text"),
        ("CONVENTIONS: dict = {**other}", "no literal text"),
    ],
)
def test_what_is_wrong_with_conventions(text: str, problem: str) -> None:
    ((told, place),) = reference_file.parse(text).problems
    assert problem in told
    assert place.line == 1


def test_a_file_that_is_no_python_is_a_mistake_of_the_user(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"reference\.py cannot be read"):
        reference_file.read_file(tmp_path)
    (tmp_path / "reference.py").write_text("def answers(:")
    with pytest.raises(UserError, match="is no Python"):
        reference_file.read_file(tmp_path)
