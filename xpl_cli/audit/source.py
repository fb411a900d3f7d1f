"""The static fact: an adapter's files as text, syntax trees and YAML, each read once; nothing is executed."""

from __future__ import annotations

import ast
import hashlib
import io
import re
import tokenize
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli import spec
from xpl_cli.audit.model import NotRun
from xpl_cli.audit.shell import Command, parse

if TYPE_CHECKING:
    from xpl_cli.audit.adapter import Adapter, Symbols

SIZE_LIMIT = 2 * 1024 * 1024
"""Files beyond this many bytes are data, not source."""

_SOURCE_SUFFIXES = frozenset((".py", ".sh", ".yml", ".yaml", ".md", ".toml", ".txt", ".cfg", ".json"))


@dataclass
class Source:
    """The boundary of one adapter: what a reader of the adapter reads.

    That is the files directly in its folder, the local modules that model.py, deploy.py and process_data.py reach (into
    a subfolder only one step, so that vendored trees are not looked at), and the Python files that process_data.sh
    calls. Paths are relative to the
    folder, with forward slashes.
    """

    path: Path
    _texts: dict[str, str] = field(default_factory=dict)
    _trees: dict[str, ast.Module] = field(default_factory=dict)
    _errors: dict[str, Exception] = field(default_factory=dict)
    _nodes: dict[str, tuple[ast.AST, ...]] = field(default_factory=dict)
    _lines: dict[str, list[str]] = field(default_factory=dict)
    _commands: dict[str, list[Command]] = field(default_factory=dict)
    _imports: dict[str, dict[str, str]] = field(default_factory=dict)
    memory: dict[str, Symbols] = field(default_factory=dict)

    @cached_property
    def files(self) -> tuple[str, ...]:
        """Names of the boundary's files, sorted."""
        named = (sdk.File.MODEL_PY, sdk.File.DEPLOY_PY)
        names = {entry.name for entry in self.path.iterdir() if entry.is_file() and not entry.is_symlink()}
        names |= {name for name in named if self.has(name)}
        entries = [*named, f"{Path(sdk.File.PROCESS_DATA_SH).stem}.py"]
        imported = {file for entry in entries for file in self.reached(entry)}
        return tuple(sorted(names | imported | self._called_by(sdk.File.PROCESS_DATA_SH)))

    @cached_property
    def python_files(self) -> tuple[str, ...]:
        """The boundary's Python files."""
        return tuple(name for name in self.files if name.endswith(".py"))

    @cached_property
    def text_files(self) -> tuple[str, ...]:
        """The boundary's files that are text by their suffix and not too large."""
        return tuple(
            name
            for name in self.files
            if Path(name).suffix in _SOURCE_SUFFIXES and (self.path / name).stat().st_size <= SIZE_LIMIT
        )

    @property
    def seen(self) -> tuple[str, ...]:
        """Names of the files that were read so far."""
        return tuple(self._texts)

    def has(self, name: str) -> bool:
        """Tell whether the folder holds a file of this name."""
        return (self.path / name).is_file()

    def text(self, name: str) -> str:
        """Return a file's text; undecodable bytes are replaced.

        Raises:
            NotRun: if there is no such file, or it is too large.
        """
        if name not in self._texts:
            file = self.path / name
            if not file.is_file():
                raise NotRun(f"there is no {name}")
            if file.stat().st_size > SIZE_LIMIT:
                raise NotRun(f"{name} is larger than {SIZE_LIMIT} bytes")
            self._texts[name] = _decoded(file.read_bytes(), python=name.endswith(".py"))
        return self._texts[name]

    def tree(self, name: str) -> ast.Module:
        """Return the syntax tree of a Python file.

        Raises:
            NotRun: if there is no such file, or it does not parse; the rule `parses` reports where.
        """
        error = self.syntax_error(name)
        if error is not None:
            raise NotRun(f"{name} does not parse: {error}")
        return self._trees[name]

    def syntax_error(self, name: str) -> Exception | None:
        """Return why a Python file does not parse, or None if it does.

        Raises:
            NotRun: if there is no such file, or it is too large.
        """
        if name not in self._trees and name not in self._errors:
            text = self.text(name)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # an invalid escape is not ours to print
                    self._trees[name] = ast.parse(text, filename=name)
            except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
                self._errors[name] = error
        return self._errors.get(name)

    def nodes(self, name: str) -> tuple[ast.AST, ...]:
        """Return everything in a Python file.

        Raises:
            NotRun: if there is no such file, or it does not parse.
        """
        if name not in self._nodes:
            self._nodes[name] = tuple(ast.walk(self.tree(name)))
        return self._nodes[name]

    def record(self) -> str:
        """Return a hash of the boundary's files, for the gate's digest."""
        contents = "\0".join(f"{name}\0{self.text(name)}" for name in self.text_files)
        return hashlib.sha256(contents.encode(errors="replace")).hexdigest()[:16]

    def yaml(self, name: str) -> Any:
        """Return what a YAML file holds.

        Raises:
            NotRun: if there is no such file, or it does not parse; the rule `parses` reports where.
        """
        problem = self.yaml_problem(name)
        if problem is not None:
            raise NotRun(f"{name} does not parse: {problem[0]}")
        return spec.read_yaml(self.path / name)

    def yaml_problem(self, name: str) -> tuple[str, int, int] | None:
        """Return why a YAML file does not parse, with line and column, or None if it does.

        Raises:
            NotRun: if there is no such file, or it is too large.
        """
        import yaml

        self.text(name)
        try:
            spec.read_yaml(self.path / name)
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark
            return str(error.problem or error), (mark.line + 1 if mark else 1), (mark.column + 1 if mark else 1)
        except (ValueError, RecursionError, yaml.YAMLError) as error:
            return " ".join(str(error).split()), 1, 1
        return None

    @cached_property
    def deploy(self) -> dict[str, Any]:
        """The map in deploy.yml; empty if it is missing or no map, which other rules report."""
        return self.manifest_of(sdk.File.DEPLOY_YML)

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """The map in policy.yml; empty for an adapter of the ecosystem, which has none."""
        return self.manifest_of(sdk.File.POLICY_YML)

    @property
    def is_ecosystem(self) -> bool:
        """Whether the adapter follows the field's layout, without a manifest of ours."""
        return not self.has(sdk.File.POLICY_YML)

    def manifest_of(self, name: str) -> dict[str, Any]:
        """Return the map in a YAML file; empty if it is missing, does not parse, or holds something else."""
        try:
            value = self.yaml(name)
        except NotRun:
            return {}
        return value if isinstance(value, dict) else {}

    def parses(self, name: str) -> bool:
        """Tell whether a Python file parses."""
        try:
            self.tree(name)
        except NotRun:
            return False
        return True

    def reached(self, name: str) -> list[str]:
        """Return a Python file and the adapter's own files that it imports, those in subfolders only one step deep."""
        found = [name] if self.has(name) else []
        for file in found:
            if "/" not in file:
                found += [other for other in dict.fromkeys(self.imports(file).values()) if other not in found]
        return found

    def imports(self, name: str) -> dict[str, str]:
        """Return the boundary's modules that a Python file imports: dotted name as written, to file."""
        if name not in self._imports:
            self._imports[name] = self._read_imports(name)
        return self._imports[name]

    def _read_imports(self, name: str) -> dict[str, str]:
        found: dict[str, str] = {}
        try:
            nodes = self.nodes(name)
        except NotRun:
            return found
        here = name.rpartition("/")[0]
        for node in nodes:
            wanted: list[tuple[str, int]] = []
            if isinstance(node, ast.Import):
                wanted = [(alias.name, 0) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                dot = "." if node.module else ""
                wanted = [(node.module or "", node.level)]
                wanted += [(f"{node.module or ''}{dot}{alias.name}", node.level) for alias in node.names]
            for module, level in wanted:
                file = self._module_file(module, level, here)
                if file is not None and file != name:
                    found["." * level + module] = file
        return found

    def at(self, name: str, node: ast.AST) -> dict[str, Any]:
        """Return a node's place for a `Finding`: file, and 1-based lines and columns counted in characters."""
        line, end = getattr(node, "lineno", 1), getattr(node, "end_lineno", None)
        place = {"path": name, "line": line, "column": self._column(name, line, getattr(node, "col_offset", 0))}
        if end is not None:
            place |= {"end_line": end, "end_column": self._column(name, end, getattr(node, "end_col_offset", 0))}
        return place

    def start(self, name: str, node: ast.AST) -> dict[str, Any]:
        """Return where a node begins, for a `Finding` about something larger than a line."""
        return {key: value for key, value in self.at(name, node).items() if not key.startswith("end")}

    def commands(self, name: str) -> list[Command]:
        """Return the commands of a shell script.

        Raises:
            NotRun: if there is no such file, or it is too large.
        """
        if name not in self._commands:
            self._commands[name] = parse(self.text(name))
        return self._commands[name]

    @cached_property
    def adapter(self) -> Adapter:
        """The class `Model` and what it reaches.

        Raises:
            NotRun: if model.py does not parse or does not define it.
        """
        from xpl_cli.audit.adapter import Adapter

        return Adapter.of(self)

    @cached_property
    def conversion_files(self) -> tuple[str, ...]:
        """The boundary's Python files that turn trajectories into training data."""
        stem = Path(sdk.File.PROCESS_DATA_SH).stem
        named = {name for name in self.python_files if Path(name).stem.startswith((stem, "convert"))}
        return tuple(sorted(named | self._called_by(sdk.File.PROCESS_DATA_SH)))

    def _column(self, name: str, line: int, offset: int) -> int:
        """Turn an offset in UTF-8 bytes, as syntax trees have it, into a column."""
        lines = self._lines.setdefault(name, self.text(name).split("\n"))
        text = lines[line - 1] if line <= len(lines) else ""
        return len(text.encode()[:offset].decode(errors="ignore")) + 1

    def _module_file(self, module: str, level: int, here: str) -> str | None:
        """Return the file of a module that an import names, if it is the adapter's own."""
        base = Path(here)
        for _ in range(level - 1):
            if base == Path():
                return None
            base = base.parent
        bases = [base] if level else [base, Path()]
        for folder in bases if module else []:
            candidate = (folder / module.replace(".", "/")).with_suffix(".py").as_posix()
            if self._is_ours(candidate):
                return candidate
        return None

    def _called_by(self, script: str) -> set[str]:
        """Return the adapter's Python files that a script calls, by any prefix that ends in its own folder."""
        if not self.has(script):
            return set()
        values: dict[str, str] = {}
        found: set[str] = set()
        for command in self.commands(script):
            values.update({variable: _expanded(word.text, values) for variable, word in command.assignments})
            for word in command.words:
                for text in re.findall(r"[^\s\"'()=]+\.py\b", _expanded(word.raw, values)):
                    parts = [part for part in text.split("/") if part not in {"", "."}]
                    tails = ("/".join(parts[place:]) for place in range(len(parts)))
                    found.update({next((tail for tail in tails if self._is_ours(tail)), "")} - {""})
        return found

    def _is_ours(self, name: str) -> bool:
        file = self.path / name
        try:
            return file.is_file() and file.resolve().is_relative_to(self.path.resolve())
        except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
            return False


def _expanded(text: str, values: dict[str, str]) -> str:
    """Put the values of known variables into a word; substitutions and the unknown become a folder of no name."""
    text = re.sub(r"\$\((?:[^()]|\([^()]*\))*\)", "", text)
    return re.sub(r"\$\{?(\w+)(?::?[-=][^}]*)?\}?", lambda found: values.get(found.group(1), ""), text)


def _decoded(data: bytes, *, python: bool) -> str:
    encoding = "utf-8"
    if python:
        try:
            encoding, _ = tokenize.detect_encoding(io.BytesIO(data).readline)
        except SyntaxError:
            encoding = "utf-8"
    try:
        text = data.decode(encoding, errors="replace")
    except LookupError:
        text = data.decode(errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").removeprefix("\ufeff")
