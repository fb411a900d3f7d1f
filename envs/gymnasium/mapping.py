"""Mapping files: how values of a Gymnasium environment become values of the standard, and the other way round.

A value is taken from somewhere by a path, and scaled: ``(from - minus) * scale + offset``, then clipped. README.md
lists the keys, `mapping.schema.json` describes them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PATH = re.compile(r"(\w+)((?:\.\w+)*)(?:\[(-?\d+)(?:(:)(-?\d+))?\])?")
_KEYS = frozenset(("from", "minus", "scale", "offset", "clip"))
_OF_FILE = frozenset(("id", "import", "kwargs", "variables", "state", "cameras", "action", "success", "score", "truth"))


class MappingError(ValueError):
    """A mapping file is invalid; the message names the entry."""


@dataclass(frozen=True)
class ValuePath:
    """Where a value lies: ``obs.agent_pos[0]`` is the first number of the entry `agent_pos` of the observation."""

    text: str
    names: tuple[str, ...]
    part: slice

    @classmethod
    def read(cls, text: str) -> ValuePath:
        """Parse a path.

        Raises:
            MappingError: it is none.
        """
        match = _PATH.fullmatch(text.strip())
        if match is None:
            raise MappingError(f"{text!r} is no path: write a source and its keys, obs.agent_pos[0] or obs.state[0:3]")
        root, keys, first, colon, end = match.groups()
        part = slice(None)
        if first is not None:
            part = slice(int(first), int(end) if colon else (int(first) + 1 or None))
        return cls(text, (root, *keys.split(".")[1:]), part)

    def value(self, sources: Mapping[str, Any]) -> Any:
        """Return what lies there, whole.

        Raises:
            MappingError: nothing does.
        """
        value: Any = sources
        for depth, name in enumerate(self.names):
            if not isinstance(value, Mapping) or name not in value:
                where = ".".join(self.names[:depth]) or "a mapping's sources"
                offered = ", ".join(map(str, value)) if isinstance(value, Mapping) else f"a {type(value).__name__}"
                raise MappingError(f"{self.text}: {where} has no {name!r}; there is {offered or 'nothing'}")
            value = value[name]
        return value

    def numbers(self, sources: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the numbers that lie there, (N,) float64.

        Raises:
            MappingError: there are none.
        """
        try:
            array = np.asarray(self.value(sources), dtype=np.float64)
        except (TypeError, ValueError) as error:
            if isinstance(error, MappingError):
                raise
            raise MappingError(f"{self.text} holds no numbers") from None
        chosen = np.atleast_1d(array).reshape(-1)[self.part]
        if chosen.size == 0:
            raise MappingError(f"{self.text}: there are only {array.size} numbers")
        return chosen


@dataclass(frozen=True)
class Value:
    """One or more numbers: constants, or what lies at a path, scaled."""

    source: ValuePath | float
    minus: ValuePath | None = None
    scale: float = 1.0
    offset: float = 0.0
    clip: tuple[float, float] | None = None

    @classmethod
    def read(cls, entry: Any, where: str) -> Value:
        """Parse a value: a number, a path, or a map with `from`.

        Raises:
            MappingError: it is invalid.
        """
        if isinstance(entry, (int, float)) and not isinstance(entry, bool):
            return cls(float(entry))
        if isinstance(entry, str):
            return cls(ValuePath.read(entry))
        if not isinstance(entry, Mapping) or "from" not in entry or not _KEYS.issuperset(entry):
            raise MappingError(
                f"{where}: expected a number, a path or a map of {', '.join(sorted(_KEYS))}; got {entry!r}"
            )
        limits = entry.get("clip")
        return cls(
            source=ValuePath.read(entry["from"]),
            minus=ValuePath.read(entry["minus"]) if "minus" in entry else None,
            scale=float(entry.get("scale", 1.0)),
            offset=float(entry.get("offset", 0.0)),
            clip=None if limits is None else (float(limits[0]), float(limits[1])),
        )

    def numbers(self, sources: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the numbers, (N,) float64."""
        if isinstance(self.source, float):
            return np.array([self.source])
        taken = self.source.numbers(sources)
        if self.minus is not None:
            taken = taken - self.minus.numbers(sources)
        result = taken * self.scale + self.offset
        return result if self.clip is None else np.clip(result, *self.clip)


Vector = tuple[Value, ...]
"""Values that are put one behind the other."""


@dataclass(frozen=True)
class EnvMapping:
    """One mapping file, read.

    Attributes:
        id: the Gymnasium environment.
        imports: modules that register it.
        kwargs: what it is made with.
        variables: environment variables that its modules read when they are imported, unless set.
        state: key of the standard's state to its values.
        cameras: camera of the standard to the path of its picture; ``render`` is what the environment renders.
        action: per action type of the standard, the values of the Gymnasium action.
        success: more than 0.5 is success.
        score: how much of the task is done without success, 0 to 1; None for nothing until success.
        truth: name to the path of what only a privileged policy sees.
    """

    id: str
    imports: tuple[str, ...]
    kwargs: Mapping[str, Any]
    variables: Mapping[str, str]
    state: Mapping[str, Vector]
    cameras: Mapping[str, ValuePath]
    action: Mapping[str, Vector]
    success: Value
    score: Value | None
    truth: Mapping[str, ValuePath]

    @classmethod
    def load(cls, file: Path) -> EnvMapping:
        """Read a mapping file.

        Raises:
            MappingError: it is invalid.
        """
        import yaml

        entries = yaml.safe_load(file.read_text(encoding="utf-8"))
        if not isinstance(entries, Mapping):
            raise MappingError(f"{file.name} must hold a map, got {type(entries).__name__}")
        unknown = [str(key) for key in entries if key not in _OF_FILE]
        missing = [key for key in ("id", "state", "action", "success") if key not in entries]
        if unknown or missing:
            wrong = [*(f"unknown {key}" for key in unknown), *(f"no {key}" for key in missing)]
            raise MappingError(f"{file.name}: {', '.join(wrong)}; the keys are {', '.join(sorted(_OF_FILE))}")
        try:
            return cls._of(entries)
        except MappingError as error:
            raise MappingError(f"{file.name}: {error}") from None

    @classmethod
    def _of(cls, entries: Mapping[str, Any]) -> EnvMapping:
        score = entries.get("score")
        return cls(
            id=str(entries["id"]),
            imports=tuple(entries.get("import", ())),
            kwargs=entries.get("kwargs", {}),
            variables={key: str(value) for key, value in entries.get("variables", {}).items()},
            state=_vectors(entries["state"], "state"),
            cameras={name: ValuePath.read(path) for name, path in entries.get("cameras", {}).items()},
            action=_vectors(entries["action"], "action"),
            success=Value.read(entries["success"], "success"),
            score=None if score is None else Value.read(score, "score"),
            truth={name: ValuePath.read(path) for name, path in entries.get("truth", {}).items()},
        )


def join(vector: Sequence[Value], sources: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the numbers of all values, one behind the other."""
    return np.concatenate([value.numbers(sources) for value in vector])


def _vectors(entries: Any, where: str) -> dict[str, Vector]:
    if not isinstance(entries, Mapping):
        raise MappingError(f"{where} must be a map, got {type(entries).__name__}")
    result = {}
    for key, values in entries.items():
        listed: Any = values if isinstance(values, list) else [values]
        result[str(key)] = tuple(Value.read(entry, f"{where}.{key}") for entry in listed)
    return result
