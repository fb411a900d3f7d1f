"""Isaac-GR00T: `processor_config.json` and `statistics.json` (N1.6, N1.7), `experiment_cfg/metadata.json` (N1, N1.5).

Source: NVIDIA/Isaac-GR00T gr00t/data/types.py (ModalityConfig, ActionConfig), gr00t/data/state_action/
state_action_processor.py, gr00t/data/utils.py, and of the older ones gr00t/data/schema.py (DatasetMetadata). The
model's inputs are those of Gr00tPolicy.get_action, which normalises, crops and pads itself, as `normalize: null` says.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints import names
from xpl_cli.adopt.checkpoints.layout import Numbers, Range
from xpl_cli.adopt.checkpoints.trained import Trained, Vector, View, upstream
from xpl_cli.adopt.facts import Evidence, Open, Told, Tree, assumed, certain, likely
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import Document, Folder

NAME: Final = "groot"
CODE: Final = "NVIDIA/Isaac-GR00T@main:gr00t"
_NEWER: Final = "processor_config.json"
_NUMBERS: Final = "statistics.json"
_OLDER: Final = "experiment_cfg/metadata.json"
_KINDS: Final = ("state", "action")


def inner(folder: Folder) -> Folder | None:
    """Return the folder of a checkpoint of GR00T; None if it is none."""
    for name in ("", "processor"):
        place = folder.below(name) if name and folder.has(name) else folder
        if place.has(_NEWER) and place.json(_NEWER).at("processor_kwargs", "modality_configs"):
            return place
    return folder if folder.has(_OLDER) else None


def read(folder: Folder, key: str | None = None) -> Trained:
    """Return what a checkpoint says.

    Args:
        folder: which holds its files.
        key: embodiment tag, where the checkpoint has several.

    Raises:
        UserError: if a file is not what it should be, or several tags leave a choice.
    """
    return _newer(folder, key) if folder.has(_NEWER) else _older(folder, key)


def _newer(folder: Folder, key: str | None) -> Trained:
    config = folder.json(_NEWER)
    stats = folder.json(_NUMBERS) if folder.has(_NUMBERS) else None
    place = ("processor_kwargs", "modality_configs")
    tag = config.chosen(config.get(dict, *place), key)
    groups = {kind: config.texts(*place, tag, kind, "modality_keys") or [] for kind in (*_KINDS, "video", "language")}
    if not groups["action"]:
        raise UserError(f"{config.place(*place)}: expected modality_keys of the actions of {tag}")
    held = _Held(stats, (tag,), config.seen("processor_kwargs", "use_percentiles"))
    steps = config.get(list, *place, tag, "action", "delta_indices", default=[])
    shown = config.get(list, *place, tag, "video", "delta_indices", default=[0])
    return Trained(
        maker=NAME,
        about=f"a policy of Isaac-GR00T for {tag}",
        family=certain("vla", config.seen("processor_class")),
        views=[_view(name, config.seen(*place, tag, "video", "modality_keys", what=name)) for name in groups["video"]],
        states=[
            held.vector(group, config.seen(*place, tag, "state", "modality_keys", what=group))
            for group in groups["state"]
        ],
        action=held.answer(groups["action"], config.seen(*place, tag, "action", "modality_keys")),
        reference=_reference(config, (*place, tag, "action", "action_configs")),
        chunk=certain(
            len(steps), config.seen(*place, tag, "action", "delta_indices", what=f"{len(steps)} delta_indices")
        )
        if steps
        else Open("how many steps an answer has: the action has no delta_indices"),
        sampling=likely("seeded", Evidence(f"{CODE}/model", None, "the action head draws noise (flow matching)")),
        instruction=_instruction(groups["language"], config.seen(*place, tag, "language", "modality_keys")),
        history=_history(shown, config.seen(*place, tag, "video", "delta_indices")),
        robot=certain(tag, config.seen(*place, tag, what=f"embodiment tag {tag}")),
        upstream=upstream("NVIDIA/Isaac-GR00T", "Apache-2.0"),
        code=_code(config.get(bool, "processor_kwargs", "formalize_language", default=False), config),
    )


def _older(folder: Folder, key: str | None) -> Trained:
    meta = folder.json(_OLDER)
    tag = meta.chosen(meta.get(dict), key)
    modalities = (tag, "modalities")
    config = folder.json("config.json") if folder.has("config.json") else None
    steps = config.get(int, "action_horizon", default=0) if config else 0
    head = ("action_head_cfg", "action_horizon")
    if config and not steps:
        steps = config.get(int, *head, default=0)
    groups = {kind: list(meta.get(dict, *modalities, kind, default={})) for kind in (*_KINDS, "video")}
    absolute = [meta.get(bool, *modalities, "action", name, "absolute", default=False) for name in groups["action"]]
    where = meta.seen(*modalities, "action", what=f"absolute: {sum(absolute)} of {len(absolute)} groups")
    own = Evidence(f"{CODE}/model/policy.py", None, "Gr00tPolicy applies the transforms of its data config")
    held = _Held(meta, (tag, "statistics"), own)
    views = []
    for name in groups["video"]:
        size = meta.numbers(*modalities, "video", name, "resolution") or []
        seen = meta.seen(*modalities, "video", name, what=f"{name}, resolution {size}")
        views.append(_view(name, seen, (int(size[1]), int(size[0])) if len(size) == 2 else None))
    return Trained(
        maker=NAME,
        about=f"a policy of Isaac-GR00T for {tag}",
        family=certain("vla", Evidence(_OLDER, None, "metadata of a checkpoint of GR00T")),
        views=views,
        states=[held.vector(group, meta.seen(*modalities, "state", group)) for group in groups["state"]],
        action=held.answer(groups["action"], where),
        reference=certain("absolute", where)
        if absolute and all(absolute)
        else Open("what actions are counted from: not all groups are absolute", (where,)),
        chunk=certain(steps, config.seen(*(head if config.at(*head) else ("action_horizon",))))
        if config and steps
        else Open("how many steps an answer has: config.json names no action_horizon"),
        sampling=likely("seeded", Evidence(f"{CODE}/model/action_head", None, "flow matching draws noise")),
        instruction={"input": assumed("annotation.human.task_description", "the data config names it; often this")},
        robot=certain(tag, meta.seen(tag, what=f"embodiment tag {tag}")),
        upstream=upstream("NVIDIA/Isaac-GR00T", "Apache-2.0"),
        notes=[
            "the data config (order of the groups, history, normalisation) is chosen by name when the policy is loaded"
        ],
    )


def _view(name: str, where: Evidence, size: tuple[int, int] | None = None) -> View:
    eye = Evidence(f"{CODE}/data", None, "video keys are uint8 RGB, (T, H, W, C)")
    rest = {"channels": likely("rgb", eye), "layout": likely("hwc", eye), "dtype": likely("uint8", eye)}
    return View(input=certain(f"video.{name}", where), names=[name], evidence=where, size=size, rest=rest)


@dataclass(frozen=True)
class _Held:
    """Statistics of one embodiment, by kind and group.

    Attributes:
        file: where they are; None where there are none.
        path: what leads to them.
        own: what says that the policy's class uses them itself.
    """

    file: Document | None
    path: tuple[str, ...]
    own: Evidence

    def vector(self, group: str, where: Evidence) -> Vector:
        """Return one group of the state as an input."""
        return Vector(self._numbers([group], "state", where), certain(f"state.{group}", where), self._normal())

    def answer(self, groups: list[str], where: Evidence) -> Vector:
        """Return all groups of an action, one after the other.

        Raises:
            UserError: there are none.
        """
        if not groups:
            raise UserError(f"{where.file}: expected the groups of an action, got none")
        return Vector(self._numbers(groups, "action", where), None, self._normal())

    def _normal(self) -> Told:
        return certain(None, Evidence(self.own.file, self.own.line, f"{self.own.what}: Gr00tPolicy normalises itself"))

    def _numbers(self, groups: list[str], kind: str, where: Evidence) -> Numbers:
        low: list[float] = []
        high: list[float] = []
        counted: list[tuple[str, int]] = []
        for group in groups:
            path = (*self.path, kind, group)
            ends = [self.file.numbers(*path, word) or [] for word in ("min", "max")] if self.file else [[], []]
            counted.append((group, len(ends[0]) or 1))
            low += ends[0]
            high += ends[1]
        width = sum(count for _, count in counted)
        within = None
        if self.file is not None and len(low) == len(high) == width:
            seen = self.file.seen(*self.path, kind, groups[0], what=f"{kind} min..max")
            within = Range(tuple(low), tuple(high), seen)
        told = Evidence(where.file, where.line, f"{where.what} ({width} numbers)")
        return Numbers(width, told, names.of_groups(counted), where, within)


def _reference(config: Document, path: tuple[str, ...]) -> Told | Open:
    configs = config.get(list, *path, default=[])
    kinds = {str(entry.get("rep")) for entry in configs if isinstance(entry, dict)}
    where = config.seen(*path, what=f"rep: {', '.join(sorted(kinds)) or 'nothing'}")
    if kinds and kinds <= {"ABSOLUTE", "RELATIVE"}:
        # What is relative to the state Gr00tPolicy makes absolute again (unapply_action).
        return likely("absolute", where)
    return Open("what actions are counted from", (where,))


def _instruction(keys: list[str], where: Evidence) -> dict[str, Tree] | None:
    return {"input": certain(keys[0], where)} if keys else None


def _history(indices: list[object], where: Evidence) -> dict[str, Tree] | None:
    found = [index for index in indices if isinstance(index, int)]
    if len(found) < 2:
        return None
    strides = {b - a for a, b in pairwise(found)}
    stride = strides.pop() if len(strides) == 1 else 0
    if stride < 1:
        return {"length": Open("video delta_indices are not evenly spaced", (where,))}
    return {"length": certain(len(found), where), "stride": certain(stride, where), "of": ["images"]}


def _code(formal: bool, config: Document) -> list[Told]:  # noqa: FBT001 - a value of the file
    if not formal:
        return []
    where = config.seen("processor_kwargs", "formalize_language")
    return [certain("the processor writes the instruction in small letters, without punctuation", where)]
