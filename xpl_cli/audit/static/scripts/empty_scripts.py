"""Scripts of a package that run nothing: their Python file does not exist, or does nothing."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.scripts import flow as script_flow
from xpl_cli.audit.static.syntax import called, last
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.audit.static.shell import ShellCommand, ShellWord
    from xpl_cli.audit.static.source import Source

RUN_BY_XPL: Final = {
    "prepare": f"{Path(sdk.File.PROCESS_DATA_SH).stem}.py",
    "train": f"{Path(sdk.File.TRAIN_SH).stem}.py",
}
"""Commands of `xpl` that run a Python file of the author, and that file."""

_PREPARES: Final = frozenset(
    (
        *("set", "exit", "return", "cd", "pushd", "popd", "mkdir", "shift", "cat", "true", "false", "read", "usage"),
        *("source", ".", "conda", "unset", "trap", "ulimit", "export", "local", "declare", "readonly", "typeset"),
    )
)
"""Programs that neither convert nor train."""
_REPORTS: Final = frozenset(
    (
        *("print", "exit", "debug", "info", "warning", "error", "critical", "exception", "basicConfig", "getLogger"),
        *("ArgumentParser", "add_argument", "parse_args", "parse_known_args"),
    )
)
"""Functions that only print, exit, or parse arguments."""
_FUNCTIONS: Final = (ast.FunctionDef, ast.AsyncFunctionDef)
_LONGEST: Final = 300
"""Most characters of a value that may be a path."""
_OWN_FOLDER: Final = re.compile(
    r"""["']?\$\((?:CDPATH='' )?(?:cd (?:-- )?)?["']?\$?\(?dirname [^/]*["')\]}]+(?: && pwd(?: -P)?)?\)?["']?"""
)
_DEFAULT: Final = re.compile(r"\$\{\w+:?-([^${}]*)\}")
_VARIABLE: Final = re.compile(r"\$\{?(\w+)\}?")


@dataclass(frozen=True)
class EmptyScript:
    """A script that runs nothing.

    Attributes:
        script: its name.
        word: the word that names its Python file; None if it names none.
        runs: the Python file that it runs, "" if it runs none.
        exists: whether that file exists, but does nothing.
        by_xpl: whether it runs by `xpl prepare` or `xpl train`, as the template's scripts do.
    """

    script: str
    word: ShellWord | None
    runs: str = ""
    exists: bool = False
    by_xpl: bool = False


def empty_scripts(source: Source) -> list[EmptyScript]:
    """Return the scripts for data and training that run nothing; none for a package for evaluation only.

    Raises:
        NotRun: if a script is too large.
    """
    if source.manifest.evaluation_only:
        return []
    names = [name for name in spec.data("package")["files"]["training"] if source.has(name)]
    results = (_check_script(source, name) for name in names)
    return [entry for entry in results if entry is not None]


def _check_script(source: Source, name: str) -> EmptyScript | None:
    """Return a script that runs nothing; None if any of its commands may do the work."""
    folders: dict[str, str] = {}
    here: str | None = ""
    empty: list[EmptyScript] = []
    for command in source.commands(name):
        if any("$(" in value.raw and ".py" in value.raw for _, value in command.assignments):
            return None
        folders.update({variable: _folder_value(value.raw, folders) for variable, value in command.assignments})
        if not command.arguments:
            continue
        words, program = script_flow.executed_words(command), _program(command)
        if program == "cd":
            here = "" if len(words) > 1 and _resolve_path(words[1].raw, folders, "") == "" else None
        if _only_prepares(command, program):
            continue
        target = _target(program, words)
        if target is None:
            return None
        by_xpl = program == "xpl"
        file = RUN_BY_XPL[target.text] if by_xpl else _resolve_path(target.raw, folders, here)
        if not file or _may_do_something(source, file):
            return None
        empty.append(EmptyScript(name, target, file, source.has(file), by_xpl))
    if empty:
        return empty[0]
    return None if source.is_ecosystem else EmptyScript(name, None)  # which has no place to say that nothing is trained


def _program(command: ShellCommand) -> str:
    words = script_flow.executed_words(command)
    return _DEFAULT.sub(r"\1", words[0].text).rpartition("/")[2] if words else ""


def _only_prepares(command: ShellCommand, program: str) -> bool:
    return script_flow.only_prints(command) or program in _PREPARES


def _target(program: str, words: Sequence[ShellWord]) -> ShellWord | None:
    """Return the word that names the Python file of a command, or the command of `xpl`; else None."""
    if program == "xpl":
        return words[1] if len(words) > 1 and words[1].text in RUN_BY_XPL else None
    if program not in {"python", "python3"}:
        return None
    rest = (word for word in words[1:] if not re.fullmatch(r"-[uBEsOI]+", word.raw))
    first = next(rest, None)
    return first if first is not None and first.text.endswith(".py") else None


def _folder_value(raw: str, folders: dict[str, str]) -> str:
    """Return the value of a variable if it is the package's folder or below it; else "?"."""
    if len(raw) > _LONGEST:
        return "?"
    if _OWN_FOLDER.fullmatch(raw) and ".." not in raw and ("BASH_SOURCE" in raw or "$0" in raw):
        return "."
    value = _resolve_path(raw, folders, None)
    return "?" if value is None else value or "."


def _resolve_path(raw: str, folders: dict[str, str], here: str | None) -> str | None:
    """Return a path relative to the package's folder, "" for that itself; None if unknown."""
    text = raw.replace('"', "").replace("'", "")
    text = _VARIABLE.sub(lambda found: folders.get(found.group(1), "?"), text)
    parts = [part for part in text.split("/") if part not in {"", "."}]
    is_own = text.startswith(".") and raw.lstrip("\"'").startswith("$")
    if "?" in text or "$" in text or "`" in text or ".." in parts or text.startswith("/"):
        return None
    return None if here is None and not is_own else "/".join(parts)


def _may_do_something(source: Source, file: str) -> bool:
    """Return whether a Python file may do something; one in a folder that does not exist yet may be added later."""
    if not source.has(file):
        folder = (source.path / file).parent
        try:
            return folder != source.path and not any(folder.glob("*.py"))
        except (OSError, ValueError):  # a name that no folder can have
            return True
    if not source.parses(file):
        return True  # the rule `parses` reports it
    tree = source.tree(file)
    own_functions = {node.name for node in source.nodes(file) if isinstance(node, _FUNCTIONS)}
    calls = {called(node) or "?" for node in source.nodes(file) if isinstance(node, ast.Call)}
    return not (all(map(_is_idle, tree.body)) and all(map(_only_reports, calls - own_functions)))


def _only_reports(function: str) -> bool:
    """Return whether a function outside of the file only prints, exits, or creates an exception."""
    name = last(function)
    return name in _REPORTS or (name == function and name.endswith(("Error", "Exception", "Exit")))


def _is_idle(node: ast.stmt) -> bool:
    """Return whether a statement only defines, prints, parses arguments or raises, whatever it calls."""
    if isinstance(node, (*_FUNCTIONS, ast.ClassDef, ast.If)):
        blocks = [*node.body, *(node.orelse if isinstance(node, ast.If) else [])]
        return not getattr(node, "decorator_list", []) and all(map(_is_idle, blocks))
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
        is_own = isinstance(node, ast.ImportFrom) and node.level > 0
        return not is_own and all(name.partition(".")[0] in {*sys.stdlib_module_names, "xpl"} for name in names)
    return isinstance(node, (ast.Pass, ast.Raise, ast.Expr, ast.Return, ast.Assign, ast.AnnAssign))
