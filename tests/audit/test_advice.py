"""Advice: what ruff and mypy say about an adapter's own files, where somebody asks for it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tests.support.adapters.rules import made_adapter
from xpl_cli.audit.engine import cache, engine
from xpl_cli.audit.engine.fixes import plan_all
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome, RuleResult
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.static import linters
from xpl_cli.audit.static.source import Source
from xpl_cli.packages.targets import requested_targets

CODES = ("XPL601", "XPL602")


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """A fresh scaffold."""
    return made_adapter(tmp_path / "Foo")


def append(file: Path, text: str) -> None:
    """Add to a file."""
    with file.open("a") as stream:
        stream.write(text)


def results(adapter: Path, *names: str, kept: Path | None = None) -> dict[str, RuleResult]:
    """Run the static gate and return the results by code."""
    report = engine.audit(adapter, "policy", AuditOptions(gates=(Gate.STATIC,), names=names, cache=kept))
    return {result.code: result for gate in report.gates for result in gate.results}


def test_advice_is_given_only_where_it_is_selected() -> None:
    """By its name, by code, by prefix; `XPL` selects everything."""
    gates = (Gate.STATIC,)
    codes = {
        names: {entry.code for entry in registry.select(names, (), gates)} for names in ((), ("advice",), ("XPL",))
    }
    assert not codes[()].intersection(CODES)
    assert codes["advice",] == set(CODES)
    assert codes["XPL",] == codes[()].union(CODES)
    assert {entry.code for entry in registry.select(("XPL6",), ("mypy-errors",), gates)} == {"XPL601"}
    assert not {entry.code for entry in registry.select(("XPL",), ("advice",), gates)}.intersection(CODES)


@pytest.mark.slow
def test_a_fresh_scaffold_needs_no_advice(adapter: Path) -> None:
    found = results(adapter, "advice")
    assert {code: result.outcome for code, result in found.items()} == dict.fromkeys(CODES, Outcome.PASS), found


@pytest.mark.slow
def test_what_a_tool_finds_is_a_warning_with_the_tool_s_own_code_and_place(adapter: Path) -> None:
    append(adapter / "model.py", '\n\ndef count() -> int:\n    return "ten", missing\n')
    line = len((adapter / "model.py").read_text().splitlines())
    found = results(adapter, "advice")
    assert {found[code].outcome for code in CODES} == {Outcome.WARN}
    (ruff,), (mypy, *_) = (found[code].findings for code in CODES)
    assert (ruff.path, ruff.line, ruff.column) == ("model.py", line, 19)
    assert ruff.message.startswith("ruff F821: Undefined name")
    assert (mypy.path, mypy.line) == ("model.py", line)
    assert ruff.evidence == {"tool": "ruff", "rule": "F821"}
    assert all(finding.got == 'return "ten", missing' for finding in (ruff, mypy))


@pytest.mark.slow
def test_the_types_of_the_sdk_count(adapter: Path) -> None:
    """A method that answers otherwise than the base class is found; numpy, of which nothing is known, is not."""
    append(adapter / "model.py", "\n    def reset(self) -> int:\n        return 1\n")
    assert any("incompatible with" in one.message for one in results(adapter, "XPL602")["XPL602"].findings)


def test_only_the_boundary_is_looked_at(adapter: Path) -> None:
    (adapter / "vendor/deep").mkdir(parents=True)
    (adapter / "vendor/deep/wrong.py").write_text("missing\n")
    assert results(adapter, "XPL601")["XPL601"].outcome is Outcome.PASS


def test_files_that_do_not_parse_are_left_to_another_rule(adapter: Path) -> None:
    """`parses` reports them; the others are still looked at."""
    (adapter / "broken.py").write_text("def (:\n")
    append(adapter / "model.py", "\n\nprint(missing)\n")
    assert [one.path for one in linters.ruff(Source(adapter))] == ["model.py"]


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_edits_that_ruff_calls_safe_are_offered(adapter: Path, ending: str) -> None:
    """`--fix --select XPL601` does them, whatever the line ending."""
    file = adapter / "model.py"
    text = file.read_text().replace("import annotations\n", "import annotations\n\nimport json\n", 1)
    file.write_bytes(text.replace("\n", ending).encode())
    options = AuditOptions(gates=(Gate.STATIC,), names=("XPL601",))
    plan_all(requested_targets([adapter]), options, unsafe=False).apply()
    assert b"import json" not in file.read_bytes()
    assert results(adapter, "XPL601")["XPL601"].outcome is Outcome.PASS


def test_no_file_of_the_adapter_is_configuration_plugin_or_module_of_a_tool(adapter: Path, tmp_path: Path) -> None:
    """A plugin would run, and so would a module that a tool imports; a configuration would silence or add rules."""
    trace = tmp_path / "trace"
    for name in ("plugin", "numpy", "ruff", "mypy", "json", "typing_extensions"):
        (adapter / f"{name}.py").write_text(f"open({str(trace)!r}, 'w').close()\nraise SystemExit('executed')\n")
    (adapter / "mypy.ini").write_text("[mypy]\nplugins = plugin.py\nignore_errors = True\n")
    (adapter / "pyproject.toml").write_text('[tool.mypy]\nplugins = ["plugin.py"]\n[tool.ruff.lint]\nselect = []\n')
    (adapter / "ruff.toml").write_text('exclude = ["*"]\n')
    append(adapter / "model.py", "\n\ndef count() -> int:\n    return missing\n")
    found = results(adapter, "advice")
    assert {found[code].outcome for code in CODES} == {Outcome.WARN}
    assert not trace.exists()
    assert not list(adapter.glob(".*_cache"))


@pytest.mark.parametrize("script", ["echo nonsense", "echo broken >&2; exit 2", "exit 1", "echo '[{}]'"])
def test_a_tool_that_answers_otherwise_is_not_green(
    adapter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str
) -> None:
    """Another version, a crash, a tool that is not there."""
    program = tmp_path / "tool"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o700)
    monkeypatch.setattr(sys, "executable", os.fspath(program))
    found = results(adapter, "advice")
    assert {found[code].outcome for code in CODES} == {Outcome.NOT_RUN}


def test_advice_is_never_taken_from_the_cache(adapter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It depends on the tool's version, which the cache does not know."""
    cache._version.cache_clear()
    assert results(adapter, "XPL601", kept=tmp_path / "cache")["XPL601"].outcome is Outcome.PASS
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert results(adapter, "XPL601", kept=tmp_path / "cache")["XPL601"].outcome is Outcome.NOT_RUN
