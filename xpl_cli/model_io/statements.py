"""The values that a model_io block gives each convention, where, and whether they are known, assumed or unknown.

statements(manifest)["gripper"]      # (Statement("state[0].parts[1].gripper", "closed: 0, open: 0.04", KNOWN),)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

from xpl.catalogue.convention import convention_of_key
from xpl.convert.gaps import gaps
from xpl.nested import format_path

if TYPE_CHECKING:
    from xpl.manifest import Manifest

Path = tuple[str | int, ...]


class Certainty(StrEnum):
    """How certain a value is; the last one counts where several apply."""

    KNOWN = "known"
    ASSUMED = "assumed"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Statement:
    """Values of one place in policy.yml.

    Attributes:
        where: the place, and further ones that say the same.
        value: what stands there, on one line.
        standing: of the value.
        why: the reason that the block gives, where it assumes a value or leaves it open.
    """

    where: tuple[str, ...]
    value: str
    standing: Certainty
    why: str = ""

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**vars(self), "where": list(self.where)}


_LONGEST: Final = 200
"""Longest text of a value, such as statistics; longer ones are cut."""


def statements(manifest: Manifest) -> dict[str, tuple[Statement, ...]]:
    """Return by convention what a manifest says of it; places that say the same are one statement."""
    block = {} if manifest.model_io is None else manifest.model_io.data
    by_convention: dict[str, list[Statement]] = {}
    values_by_place: dict[tuple[str, Path], dict[str, Any]] = {}
    for path, value in _leaves(block, ()):
        convention = convention_of_key(path)
        if convention is not None:
            values_by_place.setdefault((convention, path[:-1]), {})[str(path[-1])] = value
    if manifest.temporal.chunk is not None:
        values_by_place["chunk", ("temporal",)] = {"chunk": manifest.temporal.chunk}
    standings = _certainties(manifest)
    for (convention, path), values in values_by_place.items():
        hits = [standings[uncertain_path] for uncertain_path in standings if _touches(uncertain_path, path, values)]
        standing = max((one for one, _ in hits), key=list(Certainty).index, default=Certainty.KNOWN)
        text = ", ".join(f"{key}: {_format_value(value)}" for key, value in values.items())
        why = "; ".join(dict.fromkeys(why for _, why in hits))
        _add(
            by_convention.setdefault(convention, []), Statement((format_path(path) or "model_io",), text, standing, why)
        )
    return {convention: tuple(text) for convention, text in by_convention.items()}


def _add(statements: list[Statement], new: Statement) -> None:
    """Add a statement, or its place to that of a place that says the same."""
    for number, old in enumerate(statements):
        if replace(old, where=new.where) == new:
            statements[number] = replace(old, where=(*old.where, *new.where))
            return
    statements.append(new)


def _leaves(value: Any, path: Path) -> Iterator[tuple[Path, Any]]:
    """Yield every value of a block with its path; of parts also their order."""
    if isinstance(value, Mapping) and set(value) != {"unknown"}:
        for key, item in value.items():
            yield from _leaves(item, (*path, key))
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        if path[-1:] == ("parts",):
            yield path, [f"{kind} {how.get('arm', '')}".strip() for part in value for kind, how in part.items()]
        for index, item in enumerate(value):
            yield from _leaves(item, (*path, index))
    else:
        yield path, value


def _certainties(manifest: Manifest) -> dict[Path, tuple[Certainty, str]]:
    """Return by path below the block, or below policy.yml, what is not known there, and why."""
    by_path = {one.path: (Certainty.ASSUMED, one.why) for one in manifest.assumed}
    block = {} if manifest.model_io is None else manifest.model_io.data
    by_path = {path[1:] if path[:1] == ("model_io",) else path: certainty for path, certainty in by_path.items()}
    return by_path | {gap.path: (Certainty.UNKNOWN, gap.reason) for gap in gaps(block)}


def _touches(uncertain: Path, path: Path, values: Mapping[str, Any]) -> bool:
    """Tell whether what is not known at a path is one of the values of a place, or around them."""
    return any(uncertain == (*path, key)[: len(uncertain)] for key in values)


def _format_value(value: object) -> str:
    """Return a value as YAML writes it on one line; one that is open as a question mark."""
    import yaml

    if isinstance(value, Mapping):
        return "?"
    text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10**6)
    text = text.removesuffix("\n").removesuffix("\n...")
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
