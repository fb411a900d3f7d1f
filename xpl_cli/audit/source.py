"""The static fact: an adapter's files as text, syntax trees and YAML, each read once; nothing is executed."""

from __future__ import annotations

import ast
import hashlib
import io
import tokenize
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from xpl import _spec as sdk
from xpl_cli import spec
from xpl_cli.audit.model import NotRun

SIZE_LIMIT = 2 * 1024 * 1024
"""Files beyond this many bytes are data, not source."""

_SOURCE_SUFFIXES = frozenset((".py", ".sh", ".yml", ".yaml", ".md", ".toml", ".txt", ".cfg", ".json"))


@dataclass
class Source:
    """The boundary of one adapter: the files directly in its folder, and local modules that model.py imports.

    Vendored trees below it are not looked at. Paths are relative to the folder, with forward slashes.
    """

    path: Path
    _texts: dict[str, str] = field(default_factory=dict)
    _trees: dict[str, ast.Module] = field(default_factory=dict)

    @cached_property
    def files(self) -> tuple[str, ...]:
        """Names of the boundary's files, sorted."""
        names = {entry.name for entry in self.path.iterdir() if entry.is_file() and not entry.is_symlink()}
        names |= {name for name in (sdk.File.MODEL_PY, sdk.File.DEPLOY_PY) if (self.path / name).is_file()}
        return tuple(sorted(names | self._imported(names)))

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
        if name not in self._trees:
            try:
                self._trees[name] = ast.parse(self.text(name), filename=name)
            except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
                raise NotRun(f"{name} does not parse: {error}") from None
        return self._trees[name]

    def model_class(self) -> ast.ClassDef:
        """Return the class `Model` of model.py.

        Raises:
            NotRun: if model.py does not parse or does not define it.
        """
        wanted = spec.data("package")["model_class"]
        for node in ast.walk(self.tree(sdk.File.MODEL_PY)):
            if isinstance(node, ast.ClassDef) and node.name == wanted:
                return node
        raise NotRun(f"model.py defines no class {wanted}")

    def record(self) -> str:
        """Return a hash of the boundary's files, for the gate's digest."""
        contents = "\0".join(f"{name}\0{self.text(name)}" for name in self.text_files)
        return hashlib.sha256(contents.encode(errors="replace")).hexdigest()[:16]

    @cached_property
    def deploy(self) -> dict[str, Any]:
        """The map in deploy.yml; empty if it is missing or no map, which the rule `deploy-config` reports."""
        return self._yaml(sdk.File.DEPLOY_YML)

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """The map in policy.yml; empty for an adapter of the ecosystem, which has none."""
        return self._yaml(sdk.File.POLICY_YML)

    @property
    def is_ecosystem(self) -> bool:
        """Whether the adapter follows the field's layout, without a manifest of ours."""
        return not self.has(sdk.File.POLICY_YML)

    def _yaml(self, name: str) -> dict[str, Any]:
        import yaml

        try:
            value = spec.read_yaml(self.path / name)
        except (OSError, ValueError, RecursionError, yaml.YAMLError):
            return {}
        return value if isinstance(value, dict) else {}

    def _imported(self, top: set[str]) -> set[str]:
        """Return local modules below the folder that the boundary's own modules import, one level deep."""
        found: set[str] = set()
        for name in sorted(top & {sdk.File.MODEL_PY, sdk.File.DEPLOY_PY}):
            try:
                tree = self.tree(name)
            except NotRun:
                continue
            for node in ast.walk(tree):
                if isinstance(node, ast.ImportFrom) and node.module and node.level <= 1:
                    candidate = node.module.replace(".", "/") + ".py"
                    file = self.path / candidate
                    if file.is_file() and file.resolve().is_relative_to(self.path.resolve()):
                        found.add(candidate)
        return found


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
