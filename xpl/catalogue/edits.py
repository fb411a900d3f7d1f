"""Changes of a model_io block by place, and the places that are changed together."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Callable, Optional

from xpl.catalogue.mistake import Mistake, Place
from xpl.contract import Entry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

Block = Entry
"""A model_io block as it is written, or an entry of it."""


GONE: Any = object()
"""Takes a value out of the block."""


@dataclass(frozen=True)
class Site:
    """One place of the block that changes are made at.

    Attributes:
        place: leads there.
        entry: what is there.
        group: state or action, or "" where there are no such groups.
        name: how a finding tells it from the others, such as the arm or the image input.
    """

    place: Place
    entry: Any
    group: str = ""
    name: str = ""
    kind: str = field(default="", compare=False)


def edited(block: Block, edits: Mapping[Place, Any]) -> dict[str, Any]:
    """Return a copy of the block with values replaced or taken out."""
    result: dict[str, Any] = copy.deepcopy(dict(block))
    for place, value in edits.items():
        *way, last = place
        spot: Any = result
        for key in way:
            spot = spot[key]
        if value is GONE:
            spot.pop(last, None)
        else:
            spot[last] = copy.deepcopy(value)
    return result


def parts(block: Block, *kinds: str) -> list[Site]:
    """Return the parts of all vectors that are of these kinds, the state's first."""
    found = []
    for place, group, vector in vectors(block):
        for index, part in enumerate(vector["parts"]):
            ((kind, how),) = part.items()
            if kind in kinds:
                arm = "" if how.get("arm") == "single" else how.get("arm", "")
                found.append(Site((*place, "parts", index, kind), how, group, arm, kind))
    return found


def vectors(block: Block) -> Iterator[tuple[Place, str, Block]]:
    """Yield place, group and entry of each vector."""
    for index, entry in enumerate(block.get("state") or ()):
        yield ("state", index), "state", entry
    yield ("action",), "action", block["action"]


def scopes(sites: Sequence[Site]) -> Iterator[tuple[int, str, list[Site]]]:
    """Yield the sets of places that one mistake may cover: all, those of a group, of a name, and each alone.

    With each how much later than the first it is tried, and how a finding calls it: "" where nothing has to be told.
    """
    seen: set[frozenset[Place]] = set()
    groups = list(dict.fromkeys(site.group for site in sites))
    names = list(dict.fromkeys(site.name for site in sites))
    sets = [(0, "", list(sites))]
    sets += [(0, group, [site for site in sites if site.group == group]) for group in groups]
    sets += [(1, name, [site for site in sites if site.name == name]) for name in names]
    sets += [
        (1, ", ".join(filter(None, (group, name))), [s for s in sites if (s.group, s.name) == (group, name)])
        for group in groups
        for name in names
    ]
    sets += [(2, ", ".join(filter(None, (s.group, s.name, s.kind))), [s]) for s in sites]
    for later, told, chosen in sets:
        key = frozenset(site.place for site in chosen)
        if chosen and key not in seen:
            seen.add(key)
            yield later, f" ({told})" if told else "", chosen


Change = Callable[[Any], Optional[Block]]
"""Returns by key what becomes of an entry (`GONE` takes it out), or None where the change has no meaning."""


def everywhere(  # noqa: PLR0913 - one mistake in six words
    sites: Sequence[Site], rank: int, words: str, convention: str, change: Change, *, alone: bool = True
) -> Iterator[Mistake]:
    """Yield a change at all places that it has a meaning at, and at some of them.

    Args:
        sites: the places.
        rank: of the change at all of them.
        words: of the change.
        convention: of the vocabulary.
        change: of one entry.
        alone: also at some of the places.
    """
    fit = [(site, change(site.entry)) for site in sites]
    found = {site.place: edits for site, edits in fit if edits}
    for later, told, chosen in scopes([site for site in sites if site.place in found]):
        edits = {(*site.place, key): value for site in chosen for key, value in found[site.place].items()}
        yield Mistake(rank + later, words + told, convention, edits)
        if not alone:
            return


def at(block: Block, place: Place) -> Any:
    """Return the value at a place of the block."""
    spot: Any = block
    for key in place:
        spot = spot[key]
    return spot


def without(key: str) -> Change:
    """Return the change that takes a word out."""
    return lambda entry: {key: GONE} if key in entry else None


def word(key: str, value: Any, default: Any = None) -> Change:
    """Return the change that says another word under a key, where it is not said already; a default is not written."""

    def change(entry: Any) -> Block | None:
        if entry.get(key, default) == value:
            return None
        return {key: GONE if value == default else value}

    return change


def alike(block: Block, kinds: Sequence[str], key: str, convention: str) -> Iterator[Mistake]:
    """Yield parts of the state that say under a key what the action's of the same arm say, and the other way round."""
    for kind in kinds:
        sites = parts(block, kind)
        for group, other in (("state", "action"), ("action", "state")):
            told = {site.name: site.entry.get(key, GONE) for site in sites if site.group == other}
            edits = {
                (*site.place, key): told[site.name]
                for site in sites
                if site.group == group and told.get(site.name, site.entry.get(key, GONE)) != site.entry.get(key, GONE)
            }
            if edits:
                yield Mistake(1, f"{kind}: {key} of the {group} as of the {other}", convention, edits)
