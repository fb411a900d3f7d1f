"""Normalisation: a vector's numbers as the model gets them, and back.

Source: spec/v1/model_io.schema.json#/$defs/normalize. The numbers come from the manifest or from a file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import json_text, tables
from xpl.catalogue import AdapterCase, Convention, Mistake
from xpl.catalogue.edits import (
    REMOVE,
    Block,
    EntryChange,
    Site,
    mistakes_at_sites,
    remove_key,
    set_key,
    value_at,
    vectors,
)
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
        self._to, self._back = _Affine(width), _Affine(width)
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
        normalized = values if self._clip is None else np.clip(values, *self._clip)
        return normalized * self._back.scale + self._back.shift


class _Affine:
    """By dimension: x = scale * y + shift."""

    def __init__(self, width: int) -> None:
        self.scale, self.shift = np.ones(width), np.zeros(width)

    def put(self, where: np.ndarray, scale: float, shift: np.ndarray) -> None:
        self.scale, self.shift = np.where(where, scale, self.scale), np.where(where, shift, self.shift)


def _numbers(entry: Entry, name: str, folders: Sequence[Path], width: int, padded: int | None) -> np.ndarray:
    if "values" in entry:
        values = entry["values"].get(name)
    else:
        values = _read(
            entry["file"], folders, [*entry.get("key", "").split("/"), entry.get("names", {}).get(name, name)]
        )
    if values is None:
        raise ConversionError(
            f"normalize has no {name}, which the rule {entry['rule']} needs; add it to values, or name it"
        )
    try:
        numbers = np.asarray(values, np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise ConversionError(f"normalize: expected a list of numbers as {name}, got {str(values)[:80]}") from None
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
        searched = ", ".join(map(str, folders)) or "no folder"
        raise ConversionError(
            f"normalize names the file {file}, which is in none of: {searched}; copy it, "
            "or give its path below one of these"
        )
    return tables.read(path, words)


# -- mistakes ----------------------------------------------------------------------------------------------------------

_STATISTIC_NAMES: dict[str, tuple[dict[str, str], ...]] = {
    "mean_std": ({},),
    "min_max": ({},),
    "quantiles": ({"low": "q01", "high": "q99"}, {}, {"low": "q02", "high": "q98"}, {"low": "q10", "high": "q90"}),
}
_STATISTIC_KEYS = ("file", "key", "values")
_OSC_POSE = (0.05, 0.05, 0.05, 0.5, 0.5, 0.5)
"""`output_max` of robosuite's OSC_POSE, m and rad. Source: robosuite, controllers/config/osc_pose.json."""


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    """Yield changes of how vectors are normalised."""
    block: Block = case.block
    if not block:
        return
    sites = [
        Site((*path, "normalize"), entry["normalize"], group, str(entry.get("input", "")))
        for path, group, entry in vectors(block)
        if entry.get("normalize") and "rule" in entry["normalize"]
    ]
    yield from _without_normalization(block)
    yield from _swap_statistics(block, sites)
    for rule, named in _STATISTIC_NAMES.items():
        for names in named:
            label = f"normalize: rule: {rule}" + (f" ({', '.join(names.values())})" if names else "")
            yield from mistakes_at_sites(sites, 0, label, _NAME, _set_rule(rule, names))
    for value in (0, 1e-8, 1e-6):
        yield from mistakes_at_sites(sites, 2, f"normalize: epsilon: {value:g}", _NAME, set_key("epsilon", value, 0))
    for how in ("epsilon", "keep", "zero", "shift"):
        label = f"normalize: constant: {how}"
        yield from mistakes_at_sites(sites, 2, label, _NAME, set_key("constant", how, "refuse"))
    yield from mistakes_at_sites(sites, 1, "normalize: no clip", _NAME, remove_key("clip"))
    for clip in ([-1, 1], [-1.5, 1.5], [-5, 5], [-10, 10]):
        rank = 1 if clip == [-1, 1] else 3
        yield from mistakes_at_sites(sites, rank, f"normalize: clip: {clip}", _NAME, set_key("clip", clip, None))
    yield from mistakes_at_sites(sites, 2, "normalize: std: the root of what is said", _NAME, _raise_std(0.5))
    yield from mistakes_at_sites(sites, 2, "normalize: std: the square of what is said", _NAME, _raise_std(2.0))
    yield from mistakes_at_sites(
        sites, 1, "normalize: robosuite's output_max: 0.05 m and 0.5 rad", _NAME, _set_osc_pose
    )
    yield from mistakes_at_sites(sites, 1, "normalize: only: all", _NAME, remove_key("only"))
    yield from mistakes_at_sites(sites, 2, "normalize: only: the others", _NAME, _invert_mask)
    yield from _masks(block, sites)
    yield from _keys(sites, case.folders)


def _without_normalization(block: Block) -> Iterator[Mistake]:
    sites = [
        Site(path, entry, group, str(entry.get("input", "")))
        for path, group, entry in vectors(block)
        if entry.get("normalize")
    ]
    yield from mistakes_at_sites(sites, 0, "normalize: none", _NAME, lambda _: {"normalize": REMOVE})


def _swap_statistics(block: Block, sites: Sequence[Site]) -> Iterator[Mistake]:
    """Yield vectors normalised by another vector's numbers."""
    for site in sites:
        for other in sites:
            if other.path != site.path:
                label = f"normalize: the {_site_name(other)}'s numbers for the {_site_name(site)}"
                edits = {site.path: {**_rule_keys(site.entry), **_statistic_keys(other.entry)}}
                yield Mistake(0, label, _NAME, edits)
    if len(sites) == 2:
        one, other = sites
        both = {
            one.path: {**_rule_keys(one.entry), **_statistic_keys(other.entry)},
            other.path: {**_rule_keys(other.entry), **_statistic_keys(one.entry)},
        }
        label = f"normalize: the numbers of {_site_name(one)} and {_site_name(other)} exchanged"
        yield Mistake(1, label, _NAME, both)
    without = [
        Site((*path, "normalize"), None, group, str(entry.get("input", "")))
        for path, group, entry in vectors(block)
        if not entry.get("normalize")
    ]
    for site in without:
        for other in sites:
            label = f"normalize: the {_site_name(site)} as the {_site_name(other)}"
            yield Mistake(1, label, _NAME, {site.path: dict(other.entry)})


def _site_name(site: Site) -> str:
    return site.group + (f" {site.name}" if site.name and site.name != site.group else "")


def _rule_keys(entry: Block) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key not in _STATISTIC_KEYS}


def _statistic_keys(entry: Block) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key in _STATISTIC_KEYS}


def _set_rule(rule: str, names: Mapping[str, str]) -> EntryChange:
    def change(entry: Block) -> Block | None:
        offered = entry.get("values")
        if offered is not None:
            fits = not names and set(_NAMES[rule]) <= set(offered)
            return {"rule": rule} if fits and entry["rule"] != rule else None
        names_now = {key: entry.get("names", {}).get(key, key) for key in _NAMES[rule]}
        new_names = {key: names.get(key, key) for key in _NAMES[rule]}
        if entry["rule"] == rule and names_now == new_names:
            return None
        return {"rule": rule, "names": dict(names) or REMOVE}

    return change


def _set_osc_pose(entry: Block) -> Block | None:
    """Let changes of a pose have the range of robosuite's controller, with what follows them as it is."""
    values = entry.get("values") or {}
    if entry["rule"] != "min_max" or any(len(values.get(key, ())) < len(_OSC_POSE) for key in ("min", "max")):
        return None
    limits = {"min": [-one for one in _OSC_POSE], "max": list(_OSC_POSE)}
    changed = {key: [*limit, *values[key][len(limit) :]] for key, limit in limits.items()}
    return None if changed == {key: list(values[key]) for key in limits} else {"values": {**values, **changed}}


def _raise_std(by: float) -> EntryChange:
    """Return the change of standard deviations that are variances, or are taken for them."""

    def change(entry: Block) -> Block | None:
        offered = entry.get("values") or {}
        if "std" not in offered:
            return None
        return {"values": {**offered, "std": [abs(float(value)) ** by for value in offered["std"]]}}

    return change


def _invert_mask(entry: Block) -> Block | None:
    return {"only": [not one for one in entry["only"]]} if "only" in entry else None


def _masks(block: Block, sites: Sequence[Site]) -> Iterator[Mistake]:
    """Yield normalisation of all but grippers, as OpenVLA masks them."""
    for site in sites:
        listed = value_at(block, site.path[:-1])["parts"]
        mask = _arms(listed)
        if mask and False in mask and site.entry.get("only") != mask:
            label = f"normalize: only: all but grippers ({_site_name(site)})"
            yield Mistake(2, label, _NAME, {(*site.path, "only"): mask})


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
                label = f"normalize: key: {key or 'none'} ({_site_name(site)})"
                yield Mistake(1, label, _NAME, {(*site.path, "key"): key})


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
    keys = []
    for key in _walk(document, (), names):
        keys.append(key)
        if len(keys) == _MOST:
            break
    return keys


def _prefixes(path: Path, names: Sequence[str]) -> list[str]:
    """Return what stands before the last dot of arrays of all of these names: `action` of `action.mean`."""
    try:
        arrays = set(tables.names(path))
    except (OSError, ConversionError):
        return []
    prefixes = sorted({name.rpartition(".")[0] for name in arrays if "." in name})
    return [key for key in prefixes if all(f"{key}.{name}" in arrays for name in names)][:_MOST]


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


def _input_mistakes(_case: AdapterCase) -> Iterator[Mistake]:
    for number in range(_MOST_NUMBERS):
        yield Mistake(1, "normalize: other numbers", _NAME, input_change={"kind": "normalized", "number": number})
        yield Mistake(
            1, "normalize: other numbers of a part", _NAME, input_change={"kind": "segmented", "number": number}
        )


def _has_normalization(block: Block) -> bool:
    vectors = [*(block.get("state") or ()), block.get("action") or {}]
    return any(vector.get("normalize") is not None or "pad" in vector for vector in vectors)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    input_mistakes=_input_mistakes,
    keys={"normalize": ["*"], "vectors": ["pad"]},
    applies=_has_normalization,
)
