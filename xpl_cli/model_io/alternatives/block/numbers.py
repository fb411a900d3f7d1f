"""Other words for normalisation and padding."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl_cli.model_io.alternatives.block.edits import (
    GONE,
    Block,
    Candidate,
    Change,
    Place,
    Site,
    everywhere,
    vectors,
    word,
)
from xpl_cli.model_io.alternatives.block.statistics import entries

if TYPE_CHECKING:
    from pathlib import Path

_NEEDS = {"mean_std": ("mean", "std"), "min_max": ("min", "max"), "quantiles": ("low", "high")}
_NAMES: dict[str, tuple[dict[str, str], ...]] = {
    "mean_std": ({},),
    "min_max": ({},),
    "quantiles": ({"low": "q01", "high": "q99"}, {}, {"low": "q02", "high": "q98"}, {"low": "q10", "high": "q90"}),
}
_OFFERED = ("file", "key", "values")


def numbers(block: Block, folders: Sequence[Path]) -> Iterator[Candidate]:
    """Yield changes of how vectors are normalised."""
    sites = [
        Site((*place, "normalize"), entry["normalize"], group, str(entry.get("input", "")))
        for place, group, entry in vectors(block)
        if entry.get("normalize") and "rule" in entry["normalize"]
    ]
    yield from _none(block)
    yield from _others(block, sites)
    for rule, named in _NAMES.items():
        for names in named:
            told = f"normalize: rule: {rule}" + (f" ({', '.join(names.values())})" if names else "")
            yield from everywhere(sites, 0, told, "normalization", _ruled(rule, names))
    for value in (0, 1e-8, 1e-6):
        yield from everywhere(sites, 2, f"normalize: epsilon: {value:g}", "normalization", _said("epsilon", value, 0))
    for how in ("epsilon", "keep", "zero", "shift"):
        told = f"normalize: constant: {how}"
        yield from everywhere(sites, 2, told, "normalization", _said("constant", how, "refuse"))
    yield from everywhere(sites, 1, "normalize: no clip", "normalization", _without("clip"))
    for clip in ([-1, 1], [-1.5, 1.5], [-5, 5], [-10, 10]):
        rank = 1 if clip == [-1, 1] else 3
        yield from everywhere(sites, rank, f"normalize: clip: {clip}", "normalization", _said("clip", clip, None))
    yield from everywhere(sites, 2, "normalize: std: the root of what is said", "normalization", _powered(0.5))
    yield from everywhere(sites, 2, "normalize: std: the square of what is said", "normalization", _powered(2.0))
    yield from everywhere(sites, 1, "normalize: only: all", "normalization", _without("only"))
    yield from everywhere(sites, 2, "normalize: only: the others", "normalization", _inverted)
    yield from _masks(block, sites)
    yield from _keys(sites, folders)


def _none(block: Block) -> Iterator[Candidate]:
    sites = [
        Site(place, entry, group, str(entry.get("input", "")))
        for place, group, entry in vectors(block)
        if entry.get("normalize")
    ]
    yield from everywhere(sites, 0, "normalize: none", "normalization", lambda _: {"normalize": GONE})


def _others(block: Block, sites: Sequence[Site]) -> Iterator[Candidate]:
    """Yield vectors normalised by another vector's numbers."""
    for site in sites:
        for other in sites:
            if other.place != site.place:
                told = f"normalize: the {_called(other)}'s numbers for the {_called(site)}"
                edits = {site.place: {**_bare(site.entry), **_offer(other.entry)}}
                yield Candidate(0, told, "normalization", edits)
    if len(sites) == 2:
        one, other = sites
        both = {
            one.place: {**_bare(one.entry), **_offer(other.entry)},
            other.place: {**_bare(other.entry), **_offer(one.entry)},
        }
        told = f"normalize: the numbers of {_called(one)} and {_called(other)} exchanged"
        yield Candidate(1, told, "normalization", both)
    without = [
        Site((*place, "normalize"), None, group, str(entry.get("input", "")))
        for place, group, entry in vectors(block)
        if not entry.get("normalize")
    ]
    for site in without:
        for other in sites:
            told = f"normalize: the {_called(site)} as the {_called(other)}"
            yield Candidate(1, told, "normalization", {site.place: dict(other.entry)})


def _called(site: Site) -> str:
    return site.group + (f" {site.name}" if site.name and site.name != site.group else "")


def _bare(entry: Block) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key not in _OFFERED}


def _offer(entry: Block) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key in _OFFERED}


def _ruled(rule: str, names: Mapping[str, str]) -> Change:
    def change(entry: Block) -> Block | None:
        offered = entry.get("values")
        if offered is not None:
            fits = not names and set(_NEEDS[rule]) <= set(offered)
            return {"rule": rule} if fits and entry["rule"] != rule else None
        said = {key: entry.get("names", {}).get(key, key) for key in _NEEDS[rule]}
        wanted = {key: names.get(key, key) for key in _NEEDS[rule]}
        if entry["rule"] == rule and said == wanted:
            return None
        return {"rule": rule, "names": dict(names) or GONE}

    return change


def _said(key: str, value: Any, default: Any) -> Change:
    return word(key, value, default)


def _powered(by: float) -> Change:
    """Return the change of standard deviations that are variances, or are taken for them."""

    def change(entry: Block) -> Block | None:
        offered = entry.get("values") or {}
        if "std" not in offered:
            return None
        return {"values": {**offered, "std": [abs(float(value)) ** by for value in offered["std"]]}}

    return change


def _without(key: str) -> Change:
    return lambda entry: {key: GONE} if key in entry else None


def _inverted(entry: Block) -> Block | None:
    return {"only": [not one for one in entry["only"]]} if "only" in entry else None


def _masks(block: Block, sites: Sequence[Site]) -> Iterator[Candidate]:
    """Yield normalisation of all but grippers, as OpenVLA masks them."""
    for site in sites:
        listed = _at(block, site.place[:-1])["parts"]
        mask = _arms(listed)
        if mask and False in mask and site.entry.get("only") != mask:
            told = f"normalize: only: all but grippers ({_called(site)})"
            yield Candidate(2, told, "normalization", {(*site.place, "only"): mask})


def _arms(parts: Sequence[Block]) -> list[bool] | None:
    """Return which numbers of a vector are no gripper's; None if the width of a part is not known."""
    mask: list[bool] = []
    for part in parts:
        ((kind, how),) = part.items()
        width = _width(kind, how)
        if width is None:
            return None
        mask += [kind != "gripper"] * width
    return mask


def _width(kind: str, how: Block) -> int | None:
    if kind == "gripper":
        return len(how["closed"]) if isinstance(how["closed"], list) else 1
    return None


def _at(block: Block, place: Place) -> Any:
    spot: Any = block
    for key in place:
        spot = spot[key]
    return spot


def _keys(sites: Sequence[Site], folders: Sequence[Path]) -> Iterator[Candidate]:
    """Yield other entries of the same file that hold numbers of the same names."""
    for site in sites:
        entry = site.entry
        if "file" not in entry:
            continue
        names = [entry.get("names", {}).get(key, key) for key in _NEEDS[entry["rule"]]]
        for key in entries(entry["file"], folders, names):
            if key != entry.get("key", ""):
                told = f"normalize: key: {key or 'none'} ({_called(site)})"
                yield Candidate(1, told, "normalization", {(*site.place, "key"): key})
