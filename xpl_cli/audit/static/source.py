"""The fact `source`: an adapter's files as text, syntax trees and YAML, each read once; nothing is executed."""

from __future__ import annotations

import ast
import hashlib
import os
import re
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from xpl import _spec as sdk
from xpl import variants
from xpl.manifest import Manifest
from xpl_cli.audit.rules.model import Location, NotRun
from xpl_cli.audit.static import file_reading, imports
from xpl_cli.audit.static.file_reading import SIZE_LIMIT
from xpl_cli.audit.static.function import Function, Symbols
from xpl_cli.audit.static.limits import MOST_PYTHON, MOST_TEXT, TooMuchError, bounded_nodes
from xpl_cli.audit.static.shell import ShellScript, parse
from xpl_cli.standard import unknown

if TYPE_CHECKING:
    from collections.abc import Callable

    from yaml import Node

    from xpl.contract import Entry
    from xpl_cli.audit.static.syntax import FunctionNode
    from xpl_cli.basics.yaml import text as yaml_text

_LONGEST_PATH = 4096
"""Characters; no operating system supports longer paths."""
_MOST_PARTS = 64
_PYTHON_FILE = re.compile(r"[^\s\"'()=]+\.py\b")


@dataclass
class Source:
    """The boundary of one adapter: its own files.

    That is the files directly in its folder, the local modules that model.py, deploy.py and process_data.py reach (into
    a subfolder only one step, so that vendored code is not read), and the Python files that process_data.sh
    calls. Paths are relative to the folder, with forward slashes.

    Attributes:
        path: the adapter's folder.
        variant: the variant of policy.yml; None is the policy itself.
        memory: cache of the symbols of each file (`model_class.symbols`).
        views: cache of objects computed from the whole, by type or function.
    """

    path: Path
    variant: str | None = None
    _texts: dict[str, file_reading.FileText] = field(default_factory=dict)
    _yaml: dict[str, tuple[yaml_text.YamlDocument, tuple[str, int, int] | None]] = field(default_factory=dict)
    _parsed: dict[str, tuple[ast.AST, ...] | Exception] = field(default_factory=dict)
    _python_left: int = MOST_PYTHON
    _text_left: int = MOST_TEXT
    _lines: dict[str, list[str]] = field(default_factory=dict)
    _commands: dict[str, ShellScript] = field(default_factory=dict)
    _imports: dict[str, dict[str, str]] = field(default_factory=dict)
    _functions: dict[int, Function] = field(default_factory=dict)
    _defined: dict[str, tuple[Function, ...]] = field(default_factory=dict)
    memory: dict[str, Symbols] = field(default_factory=dict)
    views: dict[object, Any] = field(default_factory=dict)

    @cached_property
    def files(self) -> tuple[str, ...]:
        """Names of the boundary's files, sorted.

        Raises:
            NotRun: if the folder cannot be read.
        """
        named = (sdk.File.MODEL_PY, sdk.File.DEPLOY_PY)
        try:
            with os.scandir(self.path) as entries:
                names = {entry.name for entry in entries if entry.is_file(follow_symlinks=False)}
        except OSError as error:
            raise NotRun(f"the folder {self.path} cannot be read: {error.strerror or error}") from None
        names |= {name for name in named if self.has(name)}
        roots = [*named, f"{Path(sdk.File.PROCESS_DATA_SH).stem}.py"]
        imported = {file for root in roots for file in self.reached(root)}
        return tuple(sorted(names | imported | self._called_by(sdk.File.PROCESS_DATA_SH)))

    @cached_property
    def python_files(self) -> tuple[str, ...]:
        """The boundary's Python files."""
        return tuple(name for name in self.files if name.endswith(".py"))

    @cached_property
    def text_files(self) -> tuple[str, ...]:
        """The boundary's files that are text by their suffix and not too large."""
        return tuple(name for name in self.files if file_reading.is_text(name) and self._size(name) <= SIZE_LIMIT)

    @property
    def files_read(self) -> tuple[str, ...]:
        """Names of the files read so far."""
        return tuple(self._texts)

    def has(self, name: str) -> bool:
        """Return whether the folder has a file of this name."""
        return os.path.isfile(self.path / name)  # noqa: PTH113 - Path.is_file raises where nobody may look

    def text(self, name: str) -> str:
        """Return a file's text; undecodable bytes are replaced.

        Raises:
            NotRun: if there is no such file, or it cannot be read or is too large.
        """
        return self._file(name).text

    def encoding_error(self, name: str) -> str | None:
        """Return why Python cannot decode a file, or None.

        Raises:
            NotRun: if there is no such file, or it cannot be read or is too large.
        """
        return self._file(name).encoding_error

    def tree(self, name: str) -> ast.Module:
        """Return the syntax tree of a Python file.

        Raises:
            NotRun: if there is no such file, or it does not parse; the rule `parses` reports where.
        """
        return cast("ast.Module", self.nodes(name)[0])

    def syntax_error(self, name: str) -> Exception | None:
        """Return why a Python file does not parse, or None if it does.

        Raises:
            NotRun: if there is no such file, or it is too large.
        """
        result = self._syntax(name)
        return result if isinstance(result, Exception) else None

    def nodes(self, name: str) -> tuple[ast.AST, ...]:
        """Return all nodes of a Python file, the outermost first.

        Raises:
            NotRun: if there is no such file, or it does not parse.
        """
        result = self._syntax(name)
        if isinstance(result, Exception):
            raise NotRun(f"{name} does not parse: {result}")
        return result

    def _syntax(self, name: str) -> tuple[ast.AST, ...] | Exception:
        if name not in self._parsed:
            text = self.text(name)
            try:
                if len(text) > self._python_left:
                    raise TooMuchError(
                        f"the Python files of the package hold more than {MOST_PYTHON} characters together"
                    )
                self._python_left -= len(text)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # warnings on invalid escapes are not printed
                    self._parsed[name] = bounded_nodes(ast.parse(text, filename=name))
            except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
                self._parsed[name] = error.with_traceback(None)  # its frames reference the tree
        return self._parsed[name]

    def function(self, name: str, node: FunctionNode, owner: ast.ClassDef | None = None) -> Function:
        """Return a function of a Python file, cached."""
        if id(node) not in self._functions:
            self._functions[id(node)] = Function(name, node, owner)
        return self._functions[id(node)]

    def functions(self, name: str) -> tuple[Function, ...]:
        """Return every function and method that a Python file defines, nested ones too; none if it does not parse."""
        if name not in self._defined:
            nodes = self.nodes(name) if self.parses(name) else ()
            owners = {id(child): node for node in nodes if isinstance(node, ast.ClassDef) for child in node.body}
            self._defined[name] = tuple(
                self.function(name, node, owners.get(id(node)))
                for node in nodes
                if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
            )
        return self._defined[name]

    def boundary_hash(self) -> str:
        """Return a hash of the boundary's files, documentation included: those that the static gate reads."""
        return self._hash_files_where(lambda _: True)

    def record(self) -> str:
        """Return a hash of the files that affect the adapter's behaviour, for gates that run it."""
        return self._hash_files_where(lambda name: not file_reading.is_document(name))

    def _hash_files_where(self, counts: Callable[[str], bool]) -> str:
        state = hashlib.sha256()
        with suppress(NotRun):
            for name in filter(counts, self.text_files):
                with suppress(NotRun):
                    state.update(f"{name}\0{self.text(name)}\0".encode(errors="replace"))
        return state.hexdigest()[:16]

    def yaml(self, name: str) -> Any:
        """Return the value of a YAML file.

        Raises:
            NotRun: if there is no such file, or it does not parse; the rule `parses` reports where.
        """
        problem = self.yaml_problem(name)
        if problem is not None:
            raise NotRun(f"{name} does not parse: {problem[0]}")
        return self._yaml[name][0].data

    def yaml_root(self, name: str) -> Node | None:
        """Return the root node of a YAML file, with positions; None for an empty one, or one that does not parse.

        Raises:
            NotRun: if there is no such file, or it cannot be read or is too large.
        """
        self.yaml_problem(name)
        return self._yaml[name][0].root

    def yaml_problem(self, name: str) -> tuple[str, int, int] | None:
        """Return why a YAML file does not parse, with line and column, or None if it does.

        Raises:
            NotRun: if there is no such file, or it cannot be read or is too large.
        """
        if name not in self._yaml:
            self._yaml[name] = file_reading.parse_yaml(self._file(name).content)
        return self._yaml[name][1]

    @cached_property
    def deploy(self) -> Entry:
        """The mapping in deploy.yml; empty if it is missing or no mapping, which other rules report.

        Raises:
            NotRun: if there is no such variant.
        """
        written = self.manifest_of(sdk.File.DEPLOY_YML)
        return written if self.variant is None else variants.merge_patch(written, self._variant_documents[1])

    @cached_property
    def manifest(self) -> Manifest:
        """The manifest of policy.yml, without unknown values; false for an adapter of the ecosystem, which has none.

        Raises:
            NotRun: if there is no such variant.
        """
        return Manifest.parse(unknown.known(self._variant_documents[0]))

    @cached_property
    def _variant_documents(self) -> tuple[Entry, Entry]:
        """The variant's policy.yml, and its changes of deploy.yml."""
        try:
            return variants.apply_variant(self.manifest_of(sdk.File.POLICY_YML), self.variant)
        except variants.VariantError as error:
            raise NotRun(str(error)) from None

    @property
    def is_ecosystem(self) -> bool:
        """Whether the adapter has the ecosystem's layout, without a policy.yml."""
        return not self.has(sdk.File.POLICY_YML)

    def manifest_of(self, name: str) -> Entry:
        """Return the mapping in a YAML file; empty if it is missing, does not parse, or is something else."""
        try:
            value = self.yaml(name)
        except NotRun:
            return {}
        return value if isinstance(value, dict) else {}

    def parses(self, name: str) -> bool:
        """Return whether a Python file parses."""
        try:
            self.tree(name)
        except NotRun:
            return False
        return True

    def reached(self, name: str) -> list[str]:
        """Return a Python file and the adapter's own files that it imports.

        Those in subfolders only one step deep, so that vendored code is not read; a step through the `__init__.py` of
        a subfolder, which only hands names on, does not count.
        """
        files = [name] if self.has(name) else []
        for file in files:
            if "/" not in file or file.endswith(f"/{sdk.File.INIT_PY}"):
                files += [other for other in dict.fromkeys(self.imports(file).values()) if other not in files]
        return files

    def imports(self, name: str) -> dict[str, str]:
        """Return the boundary's modules that a Python file imports: dotted name as written, to file."""
        if name not in self._imports:
            self._imports[name] = imports.own_imports(self._folder, name, self.nodes(name) if self.parses(name) else ())
        return self._imports[name]

    def at(self, name: str, node: ast.AST) -> Location:
        """Return a node's location for a `Finding`."""
        location = self.start(name, node)
        end = getattr(node, "end_lineno", None)
        if end is not None:
            location["end_line"] = end
            location["end_column"] = self._column(name, end, getattr(node, "end_col_offset", 0))
        return location

    def start(self, name: str, node: ast.AST) -> Location:
        """Return the location of a node's start, for a `Finding` on something larger than a line."""
        line = getattr(node, "lineno", 1)
        return {"path": name, "line": line, "column": self._column(name, line, getattr(node, "col_offset", 0))}

    def commands(self, name: str) -> ShellScript:
        """Return the commands of a shell script.

        Raises:
            NotRun: if there is no such file, or it is too large or too deep.
        """
        if name not in self._commands:
            try:
                self._commands[name] = parse(self.text(name))
            except TooMuchError as error:
                raise NotRun(f"{name} does not parse: {error}") from None
        return self._commands[name]

    @cached_property
    def conversion_files(self) -> tuple[str, ...]:
        """The boundary's Python files that convert trajectories to training data."""
        stem = Path(sdk.File.PROCESS_DATA_SH).stem
        named = {name for name in self.python_files if Path(name).stem.startswith((stem, "convert"))}
        return tuple(sorted(named | self._called_by(sdk.File.PROCESS_DATA_SH)))

    def _column(self, name: str, line: int, offset: int) -> int:
        """Convert an offset in UTF-8 bytes, as in syntax trees, to a column."""
        if name not in self._lines:  # once for each file, not for each finding
            self._lines[name] = self.text(name).split("\n")
        lines = self._lines[name]
        text = lines[line - 1] if line <= len(lines) else ""
        return len(text.encode()[:offset].decode(errors="ignore")) + 1

    def _called_by(self, script: str) -> set[str]:
        """Return the adapter's Python files that a script runs, by any prefix that ends in its own folder."""
        values: dict[str, str] = {}
        files: set[str] = set()
        try:
            commands = self.commands(script)
        except NotRun:
            return files
        for command in commands:
            values.update({variable: _expand_variables(word.text, values) for variable, word in command.assignments})
            for word in command.words:
                for text in (
                    _PYTHON_FILE.findall(_expand_variables(word.raw, values)) if len(word.raw) <= _LONGEST_PATH else ()
                ):
                    parts = [part for part in text.split("/") if part not in {"", "."}][-_MOST_PARTS:]
                    tails = ("/".join(parts[index:]) for index in range(len(parts)))
                    ours = (file_reading.resolve_inside(self._folder, tail) for tail in tails)
                    files.update({next(filter(None, ours), "")} - {""})
        return files

    def _file(self, name: str) -> file_reading.FileText:
        if name not in self._texts:
            if self._text_left < self._size(name) <= SIZE_LIMIT:  # a larger file is not read at all
                raise NotRun(f"the files of the package hold more than {MOST_TEXT} bytes of text together")
            self._texts[name] = file_reading.read_text(self._folder, name)
            self._text_left -= len(self._texts[name].content)
        return self._texts[name]

    @cached_property
    def _folder(self) -> Path:
        return self.path.resolve()

    def _size(self, name: str) -> int:
        try:
            return (self.path / name).stat().st_size
        except OSError:  # it went away, which whoever reads it is told
            return 0


def _expand_variables(text: str, values: dict[str, str]) -> str:
    """Expand the known variables of a word; substitutions and unknown variables become empty."""
    if len(text) > _LONGEST_PATH:
        return ""
    text = re.sub(r"\$\((?:[^()]|\([^()]*\))*\)", "", text)
    expanded = re.sub(r"\$\{?(\w+)(?::?[-=][^}]*)?\}?", lambda found: values.get(found.group(1), ""), text)
    return expanded if len(expanded) <= _LONGEST_PATH else ""  # variables of variables double with each line
