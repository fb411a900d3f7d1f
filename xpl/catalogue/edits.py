"""Edits of a model_io block by path, and sets of paths that one mistake covers."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Callable, Optional

from xpl.catalogue.mistake import BlockPath, Mistake
from xpl.contract import Entry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

Block = Entry
"""A model_io block as written in policy.yml, or an entry of it."""


REMOVE: Any = object()
"""Value of an edit that removes a key."""


@dataclass(frozen=True)
class Site:
    """An entry of the block that edits apply to.

    Attributes:
        path: path of the entry.
        entry: the entry.
        group: state or action, or "" without such groups.
        name: distinguishes it from the other sites in findings, such as the arm or the image input.
    """

    path: BlockPath
    entry: Any
    group: str = ""
    name: str = ""
    kind: str = field(default="", compare=False)


def apply_edits(block: Block, edits: Mapping[BlockPath, Any]) -> dict[str, Any]:
    """Return a copy of the block with values replaced or removed."""
    result: dict[str, Any] = copy.deepcopy(dict(block))
    for path, value in edits.items():
        *parents, last = path
        node: Any = result
        for key in parents:
            node = node[key]
        if value is REMOVE:
            node.pop(last, None)
        else:
            node[last] = copy.deepcopy(value)
    return result


def parts(block: Block, *kinds: str) -> list[Site]:
    """Return the parts of these kinds of all vectors, the state's first."""
    sites = []
    for path, group, vector in vectors(block):
        for index, part in enumerate(vector["parts"]):
            ((kind, how),) = part.items()
            if kind in kinds:
                arm = "" if how.get("arm") == "single" else how.get("arm", "")
                sites.append(Site((*path, "parts", index, kind), how, group, arm, kind))
    return sites


def vectors(block: Block) -> Iterator[tuple[BlockPath, str, Block]]:
    """Yield path, group and entry of each vector."""
    for index, entry in enumerate(block.get("state") or ()):
        yield ("state", index), "state", entry
    yield ("action",), "action", block["action"]


def scopes(sites: Sequence[Site]) -> Iterator[tuple[int, str, list[Site]]]:
    """Yield the sets of sites that one mistake may cover: all, those of a group, of a name, and each alone.

    Each comes with its additional rank, and a suffix for findings, "" for the first.
    """
    seen: set[frozenset[BlockPath]] = set()
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
    for extra_rank, label, chosen in sets:
        key = frozenset(site.path for site in chosen)
        if chosen and key not in seen:
            seen.add(key)
            yield extra_rank, f" ({label})" if label else "", chosen


EntryChange = Callable[[Any], Optional[Block]]
"""Returns the new values of an entry by key (`REMOVE` removes one), or None if the change does not apply."""


def mistakes_at_sites(  # noqa: PLR0913 - one mistake in six words
    sites: Sequence[Site], rank: int, description: str, convention: str, change: EntryChange, *, partial: bool = True
) -> Iterator[Mistake]:
    """Yield a change at all sites that it applies to, and at subsets of them.

    Args:
        sites: the sites.
        rank: rank of the change at all of them; 0 is the likeliest.
        description: description of the change.
        convention: name of its convention.
        change: change of one entry.
        partial: also yield it at subsets of the sites.
    """
    fit = [(site, change(site.entry)) for site in sites]
    edits_by_path = {site.path: edits for site, edits in fit if edits}
    for extra_rank, label, chosen in scopes([site for site in sites if site.path in edits_by_path]):
        edits = {(*site.path, key): value for site in chosen for key, value in edits_by_path[site.path].items()}
        yield Mistake(rank + extra_rank, description + label, convention, edits)
        if not partial:
            return


def value_at(block: Block, path: BlockPath) -> Any:
    """Return the value at a path of the block."""
    node: Any = block
    for key in path:
        node = node[key]
    return node


def remove_key(key: str) -> EntryChange:
    """Return the change that removes a key."""
    return lambda entry: {key: REMOVE} if key in entry else None


def set_key(key: str, value: Any, default: Any = None) -> EntryChange:
    """Return the change of a key to another value.

    Args:
        key: key of an entry.
        value: new value.
        default: value of an entry without the key; to set it removes the key.

    Returns:
        a change that does not apply to entries that already have the value.
    """

    def change(entry: Any) -> Block | None:
        if entry.get(key, default) == value:
            return None
        return {key: REMOVE if value == default else value}

    return change


def copy_between_state_and_action(block: Block, kinds: Sequence[str], key: str, convention: str) -> Iterator[Mistake]:
    """Yield the value of a key copied from the action's part of an arm to the state's, and the other way round.

    Args:
        block: the model_io block.
        kinds: kinds of parts; each is copied by itself.
        key: key of the parts; a part without it removes it from the other.
        convention: name of the mistakes' convention.
    """
    for kind in kinds:
        sites = parts(block, kind)
        for group, other in (("state", "action"), ("action", "state")):
            values = {site.name: site.entry.get(key, REMOVE) for site in sites if site.group == other}
            edits = {
                (*site.path, key): values[site.name]
                for site in sites
                if site.group == group
                and values.get(site.name, site.entry.get(key, REMOVE)) != site.entry.get(key, REMOVE)
            }
            if edits:
                yield Mistake(1, f"{kind}: {key} of the {group} as of the {other}", convention, edits)
