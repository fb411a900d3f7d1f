"""Normalisation: a vector's numbers as the model gets them, and back.

Source: spec/v1/model_io.schema.json#/$defs/normalize. The numbers come from the manifest or from a file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import json_text, tables
from xpl.catalogue import Case, Convention, Mistake
from xpl.catalogue.edits import GONE, Block, Change, Site, at, everywhere, vectors, without, word
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl.contract import Entry

_NAME = "normalization"
_NAMES = {"mean_std": ("mean", "std"), "min_max": ("min", "max"), "quantiles": ("low", "high")}
_CONSTANT = {
    "keep": ((1.0, 0.0), (0.0, 1.0)),
    "zero": ((np.inf, 0.0), (0.0, 1.0)),
    "shift": ((1.0, 1.0), (1.0, 1.0)),
}
"""Dimensions that never moved, there and back: the scale, and whether min, low or mean is the shift."""


class Normalization:
    """One rule with its numbers.

    Args:
        entry: `normalize` of a vector; None leaves numbers as they are.
        width: numbers that it is applied to.
        folders: where its file may lie: the package, a checkpoint.
        padded: numbers of the padded vector; statistics may have as many, and the first are used.

    Raises:
        ConversionError: if the numbers cannot be had, or are not as many as the vector has.
    """

    def __init__(
        self, entry: Entry | None, width: int, folders: Sequence[Path] = (), padded: int | None = None
    ) -> None:
        self._clip = (entry or {}).get("clip")
        self._to, self._back = _Line(width), _Line(width)
        if entry is None:
            return
        rule, epsilon = entry["rule"], entry.get("epsilon", 0.0)
        one, two = (_numbers(entry, name, folders, width, padded) for name in _NAMES[rule])
        only = np.asarray(entry.get("only", [True] * width), bool)
        if only.shape != (width,):
            raise ConversionError(f"normalize.only has {only.size} entries, expected {width}: one for each number")
        span = two if rule == "mean_std" else two - one
        constant = only & (span == 0)
        how = entry.get("constant", "refuse")
        span = np.where(constant, epsilon, span) if how == "epsilon" else span + epsilon
        if how in ("refuse", "epsilon") and (only & (span == 0)).any():
            where = np.flatnonzero(only & (span == 0)).tolist()
            raise ConversionError(
                f"normalize divides by zero in dimensions {where}: the data never moved there; "
                "say epsilon, constant, or only"
            )
        # mean_std: y = (x - mean) / span; else y = 2 (x - low) / span - 1
        scale = span if rule == "mean_std" else span / 2
        shift = one if rule == "mean_std" else one + scale
        for line in (self._to, self._back):
            line.scale, line.shift = np.where(only, scale, 1.0), np.where(only, shift, 0.0)
        if how in _CONSTANT:
            (to_scale, to_shift), (back_scale, back_shift) = _CONSTANT[how]
            self._to.put(constant, to_scale, to_shift * one)
            self._back.put(constant, back_scale, back_shift * one)

    def encode(self, values: np.ndarray) -> np.ndarray:
        """Return normalised values (..., width)."""
        result = (values - self._to.shift) / self._to.scale
        return result if self._clip is None else np.clip(result, *self._clip)

    def decode(self, values: np.ndarray) -> np.ndarray:
        """Return what was normalised to these values (..., width)."""
        given = values if self._clip is None else np.clip(values, *self._clip)
        return given * self._back.scale + self._back.shift


class _Line:
    """By dimension: x = scale * y + shift."""

    def __init__(self, width: int) -> None:
        self.scale, self.shift = np.ones(width), np.zeros(width)

    def put(self, where: np.ndarray, scale: float, shift: np.ndarray) -> None:
        self.scale, self.shift = np.where(where, scale, self.scale), np.where(where, shift, self.shift)


def _numbers(entry: Entry, name: str, folders: Sequence[Path], width: int, padded: int | None) -> np.ndarray:
    if "values" in entry:
        found = entry["values"].get(name)
    else:
        found = _read(
            entry["file"], folders, [*entry.get("key", "").split("/"), entry.get("names", {}).get(name, name)]
        )
    if found is None:
        raise ConversionError(
            f"normalize has no {name}, which the rule {entry['rule']} needs; add it to values, or name it"
        )
    try:
        numbers = np.asarray(found, np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise ConversionError(f"normalize: expected a list of numbers as {name}, got {str(found)[:80]}") from None
    if numbers.size == padded:  # openpi's own are of the padded vector
        numbers = numbers[:width]
    if numbers.shape != (width,):
        raise ConversionError(
            f"normalize has {numbers.size} numbers as {name}, expected {width}: one for each number of the parts"
        )
    if not np.isfinite(numbers).all():
        raise ConversionError(
            f"normalize: {name} holds a number that is not finite in {np.flatnonzero(~np.isfinite(numbers))}"
        )
    return numbers


def _read(file: str, folders: Sequence[Path], words: Sequence[str]) -> Any:
    path = tables.find(file, folders)
    if path is None:
        told = ", ".join(map(str, folders)) or "no folder"
        raise ConversionError(
            f"normalize names the file {file}, which is in none of: {told}; copy it, or say where in one of these it is"
        )
    return tables.read(path, words)


# -- mistakes ----------------------------------------------------------------------------------------------------------

_CALLED: dict[str, tuple[dict[str, str], ...]] = {
    "mean_std": ({},),
    "min_max": ({},),
    "quantiles": ({"low": "q01", "high": "q99"}, {}, {"low": "q02", "high": "q98"}, {"low": "q10", "high": "q90"}),
}
_OFFERED = ("file", "key", "values")


def _in_block(case: Case) -> Iterator[Mistake]:
    """Yield changes of how vectors are normalised."""
    block: Block = case.block
    if not block:
        return
    sites = [
        Site((*place, "normalize"), entry["normalize"], group, str(entry.get("input", "")))
        for place, group, entry in vectors(block)
        if entry.get("normalize") and "rule" in entry["normalize"]
    ]
    yield from _none(block)
    yield from _others(block, sites)
    for rule, named in _CALLED.items():
        for names in named:
            told = f"normalize: rule: {rule}" + (f" ({', '.join(names.values())})" if names else "")
            yield from everywhere(sites, 0, told, _NAME, _ruled(rule, names))
    for value in (0, 1e-8, 1e-6):
        yield from everywhere(sites, 2, f"normalize: epsilon: {value:g}", _NAME, word("epsilon", value, 0))
    for how in ("epsilon", "keep", "zero", "shift"):
        told = f"normalize: constant: {how}"
        yield from everywhere(sites, 2, told, _NAME, word("constant", how, "refuse"))
    yield from everywhere(sites, 1, "normalize: no clip", _NAME, without("clip"))
    for clip in ([-1, 1], [-1.5, 1.5], [-5, 5], [-10, 10]):
        rank = 1 if clip == [-1, 1] else 3
        yield from everywhere(sites, rank, f"normalize: clip: {clip}", _NAME, word("clip", clip, None))
    yield from everywhere(sites, 2, "normalize: std: the root of what is said", _NAME, _powered(0.5))
    yield from everywhere(sites, 2, "normalize: std: the square of what is said", _NAME, _powered(2.0))
    yield from everywhere(sites, 1, "normalize: only: all", _NAME, without("only"))
    yield from everywhere(sites, 2, "normalize: only: the others", _NAME, _inverted)
    yield from _masks(block, sites)
    yield from _keys(sites, case.folders)


def _none(block: Block) -> Iterator[Mistake]:
    sites = [
        Site(place, entry, group, str(entry.get("input", "")))
        for place, group, entry in vectors(block)
        if entry.get("normalize")
    ]
    yield from everywhere(sites, 0, "normalize: none", _NAME, lambda _: {"normalize": GONE})


def _others(block: Block, sites: Sequence[Site]) -> Iterator[Mistake]:
    """Yield vectors normalised by another vector's numbers."""
    for site in sites:
        for other in sites:
            if other.place != site.place:
                told = f"normalize: the {_called(other)}'s numbers for the {_called(site)}"
                edits = {site.place: {**_bare(site.entry), **_offer(other.entry)}}
                yield Mistake(0, told, _NAME, edits)
    if len(sites) == 2:
        one, other = sites
        both = {
            one.place: {**_bare(one.entry), **_offer(other.entry)},
            other.place: {**_bare(other.entry), **_offer(one.entry)},
        }
        told = f"normalize: the numbers of {_called(one)} and {_called(other)} exchanged"
        yield Mistake(1, told, _NAME, both)
    without = [
        Site((*place, "normalize"), None, group, str(entry.get("input", "")))
        for place, group, entry in vectors(block)
        if not entry.get("normalize")
    ]
    for site in without:
        for other in sites:
            told = f"normalize: the {_called(site)} as the {_called(other)}"
            yield Mistake(1, told, _NAME, {site.place: dict(other.entry)})


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
            fits = not names and set(_NAMES[rule]) <= set(offered)
            return {"rule": rule} if fits and entry["rule"] != rule else None
        said = {key: entry.get("names", {}).get(key, key) for key in _NAMES[rule]}
        wanted = {key: names.get(key, key) for key in _NAMES[rule]}
        if entry["rule"] == rule and said == wanted:
            return None
        return {"rule": rule, "names": dict(names) or GONE}

    return change


def _powered(by: float) -> Change:
    """Return the change of standard deviations that are variances, or are taken for them."""

    def change(entry: Block) -> Block | None:
        offered = entry.get("values") or {}
        if "std" not in offered:
            return None
        return {"values": {**offered, "std": [abs(float(value)) ** by for value in offered["std"]]}}

    return change


def _inverted(entry: Block) -> Block | None:
    return {"only": [not one for one in entry["only"]]} if "only" in entry else None


def _masks(block: Block, sites: Sequence[Site]) -> Iterator[Mistake]:
    """Yield normalisation of all but grippers, as OpenVLA masks them."""
    for site in sites:
        listed = at(block, site.place[:-1])["parts"]
        mask = _arms(listed)
        if mask and False in mask and site.entry.get("only") != mask:
            told = f"normalize: only: all but grippers ({_called(site)})"
            yield Mistake(2, told, _NAME, {(*site.place, "only"): mask})


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


def _keys(sites: Sequence[Site], folders: Sequence[Path]) -> Iterator[Mistake]:
    """Yield other entries of the same file that hold numbers of the same names."""
    for site in sites:
        entry = site.entry
        if "file" not in entry:
            continue
        names = [entry.get("names", {}).get(key, key) for key in _NAMES[entry["rule"]]]
        for key in _entries(entry["file"], folders, names):
            if key != entry.get("key", ""):
                told = f"normalize: key: {key or 'none'} ({_called(site)})"
                yield Mistake(1, told, _NAME, {(*site.place, "key"): key})


# -- files of statistics: other data sets, other robots, the other vector ----------------------------------------------

_SIZE_LIMIT = 16 * 2**20
_MOST = 32


def _entries(file: str, folders: Sequence[Path], names: Sequence[str]) -> list[str]:
    """Return the keys, words separated by /, under which a file has all of these names; at most 32 of them."""
    path = tables.find(file, folders)
    if path is not None and path.suffix == ".safetensors":
        return _prefixes(path, names)
    if path is None or path.suffix != ".json" or path.stat().st_size > _SIZE_LIMIT:
        return []
    try:
        document = json_text.parse(path.read_bytes())
    except (OSError, json_text.JsonError):
        return []
    found = []
    for key in _walk(document, (), names):
        found.append(key)
        if len(found) == _MOST:
            break
    return found


def _prefixes(path: Path, names: Sequence[str]) -> list[str]:
    """Return what stands before the last dot of arrays of all of these names: `action` of `action.mean`."""
    try:
        there = set(tables.names(path))
    except (OSError, ConversionError):
        return []
    known = sorted({name.rpartition(".")[0] for name in there if "." in name})
    return [key for key in known if all(f"{key}.{name}" in there for name in names)][:_MOST]


def _walk(document: Any, way: tuple[str, ...], names: Sequence[str], depth: int = 8) -> Iterator[str]:
    if not isinstance(document, dict) or not depth:
        return
    if all(isinstance(document.get(name), list) for name in names):
        yield "/".join(way)
    for key, value in document.items():
        if "/" not in key:
            yield from _walk(value, (*way, key), names, depth - 1)


# -- in encoded inputs -------------------------------------------------------------------------------------------------

_MOST_NUMBERS = 40
"""Normalisations by numbers of the adapter's own that are tried at most."""


def _in_inputs(_case: Case) -> Iterator[Mistake]:
    for number in range(_MOST_NUMBERS):
        yield Mistake(1, "normalize: other numbers", _NAME, encoded={"kind": "normalized", "number": number})
        yield Mistake(1, "normalize: other numbers of a part", _NAME, encoded={"kind": "segmented", "number": number})


def _is_there(block: Block) -> bool:
    vectors = [*(block.get("state") or ()), block.get("action") or {}]
    return any(vector.get("normalize") is not None or "pad" in vector for vector in vectors)


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    in_inputs=_in_inputs,
    keys={"normalize": ["*"], "vectors": ["pad"]},
    applies=_is_there,
)
