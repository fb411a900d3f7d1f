"""The checkpoint that a configuration names: its files, and names and steps that do not exist."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.checkpoint import CheckpointError, resolve

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from xpl_cli.packages.package import Package

_STEP_KEY = re.compile(r"(?:(?:ckpt|checkpoint|load|model|resume)_(?:step|epoch|iter|iteration|num)|step|epoch)")
_NUMBER = re.compile(r"\d+")
_DEPTH = 2
"""How far below the checkpoint's folder the entries of training steps are looked for."""


@dataclass(frozen=True)
class ServedCheckpoint:
    """The checkpoint of a configuration.

    Attributes:
        key: the key of deploy.yml that names it.
        name: the value of that key.
        path: the file or folder.
        config: the configuration.
        policy_dir: folder that relative paths start at.
    """

    key: str
    name: str
    path: Path
    config: Mapping[str, object]
    policy_dir: Path

    @classmethod
    def of(cls, package: Package, config: Mapping[str, object]) -> ServedCheckpoint | None:
        """Return the checkpoint of a configuration, None if it names none that exists."""
        keys = (*sdk.CHECKPOINT_KEYS, sdk.Deploy.CKPT_NAME)
        key = next((key for key in keys if config.get(key) not in (None, "")), None)
        if key is None:
            return None
        try:
            return cls(key, str(config[key]), resolve(config, package.path), config, package.path)
        except CheckpointError:
            return None

    def state(self) -> dict[Path, tuple[int, int]]:
        """Return size in bytes and time of the last change in ns of every file."""
        files = [self.path] if self.path.is_file() else sorted(self.path.rglob("*"))
        return {file: (file.stat().st_size, file.stat().st_mtime_ns) for file in files if file.is_file()}

    def absent_names(self) -> list[str]:
        """Return names similar to that of the checkpoint that do not exist: a longer one, and a prefix."""
        beginning = re.sub(r"(\d)\d+$", r"\1", self.name)
        near = [f"{self.name}-missing", beginning if beginning != self.name else self.name[:-1]]
        return [name for name in near if name and not self._resolves(name)]

    def step_keys(self) -> Iterator[tuple[str, int]]:
        """Yield the keys that select a training step of the checkpoint, with an existing step."""
        steps = self.steps()
        for key, value in self.config.items():
            if not _STEP_KEY.fullmatch(key) or not steps:
                continue
            step = max(steps) if value is None else value if type(value) is int else None
            if step in steps:
                yield key, step

    def steps(self) -> set[int]:
        """Return the training steps in the names of its files and folders."""
        depths = ["/".join("*" * depth) for depth in range(1, _DEPTH + 1)]
        names = {entry.stem for pattern in depths for entry in self.path.glob(pattern)} if self.path.is_dir() else set()
        return {int(number) for name in names for number in _NUMBER.findall(name)}

    def absent_steps(self, step: int) -> list[int]:
        """Return missing steps that careless code may take for this one: 0, a prefix, a longer one."""
        return [other for other in dict.fromkeys((0, int(str(step)[0]), 10 * step)) if other not in self.steps()]

    def _resolves(self, name: str) -> bool:
        try:
            resolve({**self.config, self.key: name}, self.policy_dir)
        except CheckpointError:
            return False
        return True
