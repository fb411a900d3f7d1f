"""No test depends on how busy a machine is."""

from __future__ import annotations

import ast
from pathlib import Path

import hypothesis

from tests.support.places import tracked


def _deadlines(path: Path) -> list[str]:
    """Return where a test waits for so many seconds and no longer."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            given = [keyword.value for keyword in node.keywords if keyword.arg == "timeout"]
            if isinstance(node.func, ast.Attribute) and node.func.attr in {"wait", "join", "settimeout"}:
                given += node.args
            if any(isinstance(value, ast.Constant) and value.value for value in given):
                found.append(f"{path.name}:{node.lineno}")
    return found


def test_no_test_waits_a_number_of_seconds(tmp_path: Path) -> None:
    """`DEADLINE_S` of `tests.support.peer` is the one deadline; nothing that works comes near it."""
    tests = tracked("tests/**/*.py")
    assert len(tests) > 100
    assert [place for path in tests for place in _deadlines(path)] == []
    planted = tmp_path / "planted.py"
    planted.write_text(
        "process.wait(5)\nprocess.communicate(timeout=5)\nthread.join(1.5)\n"
        "process.wait(0.0)\nprocess.wait(DEADLINE_S)\n', '.join(names)\n"
    )
    assert _deadlines(planted) == ["planted.py:1", "planted.py:2", "planted.py:3"]


def test_examples_of_hypothesis_have_no_deadline() -> None:
    """A slow one is no fault, and neither is a slow start of them."""
    assert hypothesis.settings.default is not None
    assert hypothesis.settings.default.deadline is None
    assert hypothesis.HealthCheck.too_slow in hypothesis.settings.default.suppress_health_check
