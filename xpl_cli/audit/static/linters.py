"""Messages of ruff and mypy on an adapter's own files.

Both run on a copy of the boundary in an empty folder, as the audit has read it. So they read no configuration, plugin
or stub beside the adapter, follow no import into vendored code, and their locations match the text that fixes edit.
Neither executes what it reads. Their messages depend on their version, and are therefore never cached.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import json_text
from xpl_cli.audit.rules.model import Edit, Finding, Fix, NotApplicable, NotRun

if TYPE_CHECKING:
    from xpl.contract import Entry
    from xpl_cli.audit.static.source import Source

_SELECTED: Final = (
    "F",  # undefined names, unused values
    "B",  # likely bugs: mutable defaults, closures over loop variables
    "PLE",  # code that fails when it runs
    "NPY",  # the global random state, names that numpy has removed
    "S301",  # unpickling
    "S506",  # loading YAML that can construct objects
)
_IGNORED: Final = (
    "F403",  # star imports: see XPL107
    "F405",
    "F541",  # an f-string without a value is harmless
    "B007",  # an unused loop variable is harmless
    "B028",  # the stack level of a warning
    "B904",  # the form of a traceback
    "B905",  # `zip(strict=)` is newer than the Python of many policies
)
_RUFF: Final = (
    *("check", "--isolated", "--no-cache", "--no-fix", "--exit-zero", "--output-format", "json"),
    *("--select", ",".join(_SELECTED), "--ignore", ",".join(_IGNORED)),
)
_MYPY: Final = (
    *("--config-file=", "--no-incremental", f"--cache-dir={os.devnull}", "--no-site-packages"),
    *("--ignore-missing-imports", "--follow-imports=silent", "--check-untyped-defs", "--no-error-summary"),
    *("--explicit-package-bases", "--namespace-packages", "--disable-error-code", "var-annotated"),
    # Attributes that are None until `load` are usual here, and nine in ten findings without this.
    "--no-strict-optional",
    *("--output", "json"),
)
_SDK: Final = "xpl"
_PATIENCE: Final = 90.0
"""Timeout of a tool, s."""


@dataclass(frozen=True)
class ToolMessage:
    """One message of a tool.

    Attributes:
        tool, rule: the tool, and its own rule code.
        message: the text.
        path, line, column, end_line, end_column: its location; 1-based, columns in characters.
        fix: the tool's suggestion.
    """

    tool: str
    rule: str
    message: str
    path: str
    line: int
    column: int
    end_line: int
    end_column: int
    fix: Fix

    def finding(self, source: Source) -> Finding:
        """Return it as a finding of the audit."""
        lines = source.text(self.path).split("\n")
        return Finding(
            f"{self.tool} {self.rule}: {self.message}",
            path=self.path,
            line=self.line,
            column=self.column,
            end_line=self.end_line,
            end_column=self.end_column,
            expected=f"code without messages of {self.tool}",
            got=lines[self.line - 1].strip()[:80] if self.line <= len(lines) else "",
            evidence={"tool": self.tool, "rule": self.rule},
            fix=self.fix,
        )


def ruff(source: Source) -> tuple[ToolMessage, ...]:
    """Return the messages of ruff, in order of location.

    Raises:
        NotRun: if it does not answer.
        NotApplicable: if no Python file of the adapter parses.
    """
    with _copy_python_files(source) as (folder, names):
        output = _run_tool("ruff", [*_RUFF, "--", *names], folder)
        try:
            return _sorted(_parse_ruff(entry, folder) for entry in json_text.parse(output) if entry["code"])
        except (ValueError, KeyError, TypeError) as error:
            raise NotRun(f"the output of ruff has an unknown form: {error}") from None


def mypy(source: Source) -> tuple[ToolMessage, ...]:
    """Return the errors of mypy, in order of location. Untyped functions are checked; other packages count as untyped.

    Raises:
        NotRun: if it does not answer.
        NotApplicable: if no Python file of the adapter parses.
    """
    with _copy_python_files(source) as (folder, names):
        package = folder.name  # relative imports need one
        files = {f"{package}/{name}": name for name in names}
        output = _run_tool("mypy", [*_MYPY, "--", *files], folder.parent)
        try:
            entries = [json_text.parse(line) for line in output.splitlines() if line.strip()]
            errors = (entry for entry in entries if entry["severity"] == "error" and entry["file"] in files)
            return _sorted(_parse_mypy(entry, files[entry["file"]]) for entry in errors)
        except (ValueError, KeyError, TypeError) as error:
            raise NotRun(f"the output of mypy has an unknown form: {error}") from None


@contextmanager
def _copy_python_files(source: Source) -> Iterator[tuple[Path, list[str]]]:
    """Copy the boundary's Python files that parse; yield the copy's folder and their names."""
    names = [name for name in source.python_files if source.parses(name)]
    if not names:
        raise NotApplicable("no Python file of the adapter parses")
    with tempfile.TemporaryDirectory(prefix="xpl-advice-") as temporary:
        folder = Path(temporary).resolve() / "boundary"
        for name in names:
            file = folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(source.text(name), encoding="utf-8", errors="replace", newline="\n")
        yield folder, names


def _run_tool(tool: str, arguments: list[str], folder: Path) -> str:
    """Run a tool and return its output.

    Raises:
        NotRun: if it crashes or takes too long.
    """
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("RUFF_", "MYPY"))}
    if tool == "mypy":
        variables["MYPYPATH"] = str(_sdk(folder / "sdk"))
    try:
        process = subprocess.run(
            # The one that came with xpl, also where its scripts are not on PATH. -P: the copy holds the adapter's
            # files, and none of them may be imported for a module of the tool.
            [sys.executable, "-P", "-m", tool, *arguments],
            cwd=folder,
            env=variables,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=_PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise NotRun(f"{tool} has not ended after {_PATIENCE:.0f} s") from None
    except OSError as error:
        raise NotRun(f"{tool} cannot be started: {error}") from None
    # If Python cannot start the tool, the exit code is 1 as with findings, but nothing is printed.
    if process.returncode not in {0, 1} or (process.returncode and not process.stdout):
        error_lines = (process.stderr or process.stdout).strip().splitlines()
        raise NotRun(f"{tool} fails: {error_lines[-1] if error_lines else f'exit code {process.returncode}'}")
    return process.stdout


def _sdk(folder: Path) -> Path:
    """Return a folder from which only the SDK, which has types, can be imported."""
    import xpl

    folder.mkdir()
    (folder / _SDK).symlink_to(Path(xpl.__file__).parent, target_is_directory=True)
    return folder


def _sorted(messages: Iterator[ToolMessage]) -> tuple[ToolMessage, ...]:
    return tuple(sorted(messages, key=lambda one: (one.path, one.line, one.column, one.rule)))


def _parse_ruff(entry: Entry, folder: Path) -> ToolMessage:
    path = Path(entry["filename"]).resolve().relative_to(folder).as_posix()
    begin, end = entry["location"], entry["end_location"]
    position = begin["row"], begin["column"], end["row"], end["column"]
    return ToolMessage(
        "ruff", entry["code"], entry["message"], path, *position, _fix(entry["fix"], entry["code"], path)
    )


def _fix(ruff_fix: Entry | None, rule: str, path: str) -> Fix:
    """Return ruff's own edit if it is safe or unsafe, and not for display only."""
    kind = {"safe": "safe_edit", "unsafe": "unsafe_edit"}.get(ruff_fix["applicability"]) if ruff_fix else None
    if ruff_fix is None or kind is None:
        return Fix("advice", f"`ruff rule {rule}` explains it")
    edits = tuple(
        Edit(
            path,
            edit["location"]["row"],
            edit["location"]["column"],
            edit["end_location"]["row"],
            edit["end_location"]["column"],
            edit["content"],
        )
        for edit in ruff_fix["edits"]
    )
    return Fix(kind, ruff_fix["message"] or f"ruff's fix for {rule}", edits)


def _parse_mypy(entry: Entry, path: str) -> ToolMessage:
    line, column = int(entry["line"]), int(entry["column"]) + 1
    hint = entry.get("hint") or "declare the type by an annotation or a check, or correct the value"
    return ToolMessage(
        tool="mypy",
        rule=str(entry["code"] or "error"),
        message=str(entry["message"]),
        path=path,
        line=max(line, 1),
        column=max(column, 1),
        end_line=max(line, 1),
        end_column=max(column, 1),
        fix=Fix("advice", " ".join(str(hint).split())),
    )
