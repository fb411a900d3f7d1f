"""Other words for images: colours, numbers, cameras, geometry and filters."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from xpl.convert.images import shape_after
from xpl_cli.model_io.alternatives.block.edits import GONE, Block, Candidate, Change, Place, Site, everywhere, word
from xpl_cli.model_io.alternatives.forms import MEANS, RANGES

_NOMINAL = (480, 640)
"""Height and width for which a change of geometry has to leave the model's size."""
_FILTERS = ("bilinear", "area", "bicubic", "lanczos", "nearest")
_FRACTIONS = (0.9, 0.95, 0.9486832980505138, 0.875)


def images(block: Block, embodiment_cameras: Sequence[str]) -> Iterator[Candidate]:
    """Yield changes of the image inputs."""
    entries = block.get("images") or []
    sites = [Site(("images", index), entry, "", entry["input"]) for index, entry in enumerate(entries)]
    for colours in ("bgr", "rgb"):
        yield from everywhere(sites, 0, f"channels: {colours}", "image_channels", word("channels", colours))
    yield from _numbers(sites)
    yield from _cameras(entries, embodiment_cameras)
    yield from _turns(sites)
    yield from _sizes(sites)
    yield from _resampling(sites)


# -- numbers -----------------------------------------------------------------------------------------------------------


def _numbers(sites: Sequence[Site]) -> Iterator[Candidate]:
    for rank, span in RANGES:
        yield from everywhere(sites, rank, f"range: {span}", "image_range", _ranged(span))
    yield from everywhere(sites, 2, "dtype: uint8", "image_range", _as_bytes)
    yield from everywhere(sites, 0, "mean and std: none", "image_range", _without_mean)
    for name, (mean, std) in MEANS.items():
        yield from everywhere(sites, 1, f"mean and std: {name}", "image_range", _with_mean(mean, std))
    yield from everywhere(sites, 2, "mean and std in the other order of channels", "image_range", _mean_reversed)


def _as_float(entry: Block) -> dict[str, Any]:
    return {} if entry["dtype"] == "float32" else {"dtype": "float32"}


def _as_bytes(entry: Block) -> Block | None:
    return None if entry["dtype"] == "uint8" else {"dtype": "uint8", "range": GONE, "mean": GONE, "std": GONE}


def _ranged(span: Sequence[float]) -> Change:
    def change(entry: Block) -> Block | None:
        if entry["dtype"] == "float32" and list(entry.get("range", [0, 1])) == span:
            return None
        return {"range": GONE if span == [0, 1] else span, **_as_float(entry)}

    return change


def _without_mean(entry: Block) -> Block | None:
    return {"mean": GONE, "std": GONE} if {"mean", "std"} & set(entry) else None


def _with_mean(mean: Sequence[float], std: Sequence[float]) -> Change:
    def change(entry: Block) -> Block | None:
        if (entry.get("mean"), entry.get("std")) == (mean, std):
            return None
        return {"mean": mean, "std": std, "range": GONE, **_as_float(entry)}

    return change


def _mean_reversed(entry: Block) -> Block | None:
    turned = {key: entry[key][::-1] for key in ("mean", "std") if key in entry}
    return turned if any(entry[key] != values for key, values in turned.items()) else None


# -- cameras -----------------------------------------------------------------------------------------------------------


def _cameras(entries: Sequence[Block], known: Sequence[str]) -> Iterator[Candidate]:
    used = list(dict.fromkeys(camera for entry in entries for camera in entry["cameras"]))
    wrists = [camera for camera in used if "wrist" in camera]
    pairs = sorted(itertools.combinations(used, 2), key=lambda pair: not set(pair) <= set(wrists))
    for one, other in pairs:
        places = {one: other, other: one}
        edits: dict[Place, Any] = {
            ("images", index, "cameras"): [places.get(camera, camera) for camera in entry["cameras"]]
            for index, entry in enumerate(entries)
            if set(entry["cameras"]) & {one, other}
        }
        rank = 0 if {one, other} <= set(wrists) else 1
        yield Candidate(rank, f"cameras: {one} and {other} exchanged", "camera", edits)
    for index, entry in enumerate(entries):
        yield from _other_cameras(index, entry, known)


def _other_cameras(index: int, entry: Block, known: Sequence[str]) -> Iterator[Candidate]:
    cameras, place = list(entry["cameras"]), ("images", index, "cameras")
    if len(cameras) > 2:
        for order in itertools.islice(itertools.permutations(cameras), 1, 25):
            yield Candidate(2, f"cameras: {', '.join(order)} ({entry['input']})", "camera", {place: list(order)})
    if len(cameras) == 2:
        turned = cameras[::-1]
        yield Candidate(1, f"cameras: {', '.join(turned)} ({entry['input']})", "camera", {place: turned})
    for position, camera in enumerate(cameras):
        for other in known:
            if other not in cameras:
                changed = [*cameras[:position], other, *cameras[position + 1 :]]
                words = f"cameras: {other} instead of {camera} ({entry['input']})"
                yield Candidate(2, words, "camera", {place: changed})


# -- geometry ----------------------------------------------------------------------------------------------------------


def _turns(sites: Sequence[Site]) -> Iterator[Candidate]:
    steps: list[tuple[int, Step]] = [(0, {"rotate": 180}), (0, {"mirror": "left_right"})]
    steps += [(1, {"mirror": "up_down"}), (2, {"rotate": 90}), (2, {"rotate": 270})]
    for rank, step in steps:
        ((kind, how),) = step.items()
        yield from everywhere(sites, rank, f"{kind}: {how} added", "image_orientation", _stepped(_appended(step)))
        yield from everywhere(sites, 3, f"{kind}: {how} first", "image_orientation", _stepped(_prepended(step)))
    for kind in ("rotate", "mirror"):
        yield from everywhere(sites, 0, f"no {kind}", "image_orientation", _stepped(_lacking(kind)))
    for kind, others in (("rotate", (90, 180, 270)), ("mirror", ("left_right", "up_down"))):
        for how in others:
            yield from everywhere(sites, 1, f"{kind}: {how}", "image_orientation", _stepped(_said(kind, how)))
    turn = _stepped(_replaced("mirror", {"rotate": 180}))
    yield from everywhere(sites, 1, "rotate: 180 instead of mirror", "image_orientation", turn)
    for how in ("left_right", "up_down"):
        flip = _stepped(_replaced("rotate", {"mirror": how}))
        yield from everywhere(sites, 1, f"mirror: {how} instead of rotate", "image_orientation", flip)


def _sizes(sites: Sequence[Site]) -> Iterator[Candidate]:
    yield from everywhere(
        sites, 1, "resize instead of letterbox", "image_size", _stepped(_converted("letterbox", "resize"))
    )
    for rank, told, more in (
        (1, "", {}),
        (2, ", anchor: bottom_right", {"anchor": "bottom_right"}),
        (2, ", anchor: top_left", {"anchor": "top_left"}),
        (3, ", fill: 127", {"fill": 127}),
        (3, ", fill: 255", {"fill": 255}),
    ):
        change = _stepped(_converted("resize", "letterbox", more))
        yield from everywhere(sites, rank, f"letterbox instead of resize{told}", "image_size", change)
    yield from everywhere(sites, 1, "no crop", "image_size", _stepped(_lacking("crop")))
    for fraction in _FRACTIONS:
        crop = {"crop": {"fraction": fraction}}
        told = f"crop: {{fraction: {fraction:.6g}}}"
        yield from everywhere(sites, 3, f"{told} first", "image_size", _stepped(_prepended(crop)))
        yield from everywhere(sites, 2, told, "image_size", _stepped(_said("crop", crop["crop"])))
    for anchor in ("center", "bottom_right", "top_left"):
        edit = _stepped(_inside("letterbox", "anchor", anchor, "center"))
        yield from everywhere(sites, 2, f"anchor: {anchor}", "image_size", edit)
    for fill in (0, 127, 128, 114, 255):
        yield from everywhere(sites, 2, f"fill: {fill}", "image_size", _stepped(_inside("letterbox", "fill", fill, 0)))
    yield from everywhere(sites, 1, "to: height and width exchanged", "image_size", _exchanged)
    yield from everywhere(sites, 3, "steps in the other order", "image_size", _stepped(lambda steps: steps[::-1]))


def _exchanged(entry: Block) -> Block | None:
    """Exchange height and width of the size that the model reads."""
    steps = [
        {kind: {**how, "to": how["to"][::-1]} if isinstance(how, Mapping) and "to" in how else how}
        for step in entry.get("steps", ())
        for kind, how in step.items()
    ]
    return {"steps": steps} if steps != list(entry.get("steps", ())) else None


def _resampling(sites: Sequence[Site]) -> Iterator[Candidate]:
    for value in (True, False):
        edit = _stepped(_inside("", "antialias", value, default=False))
        yield from everywhere(sites, 1, f"antialias: {str(value).lower()}", "image_filter", edit)
    for kind in _FILTERS:
        for antialias, rank in ((None, 1), (True, 2), (False, 2)):
            told = f"filter: {kind}" + ("" if antialias is None else f", antialias: {str(antialias).lower()}")
            yield from everywhere(sites, rank, told, "image_filter", _stepped(_filtered(kind, antialias)))
    for kind in ("float", "uint8"):
        yield from everywhere(sites, 2, f"as: {kind}", "image_filter", _stepped(_inside("", "as", kind, "uint8")))


Step = dict[str, Any]
"""One step of `images[].steps`: its kind and how."""
Steps = list[Step]
StepsChange = Callable[[Steps], Steps | None]
"""Returns what becomes of the steps of an image, or None where the change has no meaning."""


def _stepped(change: StepsChange) -> Change:
    """Return the change of an image input that `change` makes of its steps, if its size stays."""

    def of(entry: Block) -> Block | None:
        steps: Steps = list(entry.get("steps", ()))
        changed = change(steps)
        if changed is None or changed == steps or _size(steps) != _size(changed):
            return None
        return {"steps": changed or GONE}

    return of


def _size(steps: Steps) -> tuple[int, int] | None:
    shape = _NOMINAL
    try:
        for step in steps:
            ((kind, how),) = step.items()
            shape = shape_after(kind, how, shape)
    except ValueError:  # a crop that is larger than the nominal image
        return None
    return shape


def _appended(step: Step) -> StepsChange:
    return lambda steps: None if any(step.keys() == one.keys() for one in steps) else [*steps, step]


def _prepended(step: Step) -> StepsChange:
    return lambda steps: None if not steps or any(step.keys() == one.keys() for one in steps) else [step, *steps]


def _lacking(kind: str) -> StepsChange:
    return lambda steps: [step for step in steps if kind not in step]


def _said(kind: str, how: Any) -> StepsChange:
    return lambda steps: [{kind: how} if kind in step else step for step in steps]


def _replaced(kind: str, by: Step) -> StepsChange:
    return lambda steps: [by if kind in step else step for step in steps]


def _converted(one: str, other: str, more: Block | None = None) -> StepsChange:
    kept = {"to", "filter", "antialias", "as"}

    def change(steps: Steps) -> Steps:
        return [
            {other: {**{key: value for key, value in step[one].items() if key in kept}, **(more or {})}}
            if one in step
            else step
            for step in steps
        ]

    return change


def _inside(kind: str, key: str, value: Any, default: Any) -> StepsChange:
    """Return the change that says a word in each step of a kind, or in each that resamples."""

    def change(steps: Steps) -> Steps:
        result = []
        for step in steps:
            ((name, how),) = step.items()
            meant = name == kind if kind else name in ("resize", "letterbox")
            if not meant or how.get(key, default) == value:
                result.append(step)
                continue
            said = {} if value == default else {key: value}
            result.append({name: {**{word: told for word, told in how.items() if word != key}, **said}})
        return result

    return change


def _filtered(kind: str, antialias: bool | None) -> StepsChange:  # noqa: FBT001 - a word of the block
    def change(steps: Steps) -> Steps:
        more: dict[str, Any] = {} if antialias is None else {"antialias": antialias}
        return [
            {name: {**how, "filter": kind, **more}} if name in ("resize", "letterbox") else step
            for step in steps
            for name, how in step.items()
        ]

    return change
