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
from xpl_cli.adopt.checkpoints.layout import DataRange, VectorNumbers
from xpl_cli.adopt.checkpoints.trained_model import ImageSpec, TrainedModel, VectorSpec, upstream
from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, assumed, certain, likely
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument

NAME: Final = "groot"
CODE: Final = "NVIDIA/Isaac-GR00T@main:gr00t"
_NEWER: Final = "processor_config.json"
_NUMBERS: Final = "statistics.json"
_OLDER: Final = "experiment_cfg/metadata.json"
_KINDS: Final = ("state", "action")


def inner(folder: CheckpointFolder) -> CheckpointFolder | None:
    """Return the folder of a checkpoint of GR00T; None if it is none."""
    for name in ("", "processor"):
        candidate = folder.below(name) if name and folder.has(name) else folder
        if candidate.has(_NEWER) and candidate.json(_NEWER).at("processor_kwargs", "modality_configs"):
            return candidate
    return folder if folder.has(_OLDER) else None


def read(folder: CheckpointFolder, key: str | None = None) -> TrainedModel:
    """Read a checkpoint.

    Args:
        folder: with its files.
        key: embodiment tag, if the checkpoint has several.

    Raises:
        UserError: a file is invalid, or the checkpoint has several tags and `key` is None.
    """
    return _read_processor_config(folder, key) if folder.has(_NEWER) else _read_metadata(folder, key)


def _read_processor_config(folder: CheckpointFolder, key: str | None) -> TrainedModel:
    config = folder.json(_NEWER)
    stats = folder.json(_NUMBERS) if folder.has(_NUMBERS) else None
    path = ("processor_kwargs", "modality_configs")
    tag = config.choose_entry(config.get(dict, *path), key)
    groups = {kind: config.texts(*path, tag, kind, "modality_keys") or [] for kind in (*_KINDS, "video", "language")}
    if not groups["action"]:
        raise UserError(f"{config.location(*path)}: expected modality_keys of the actions of {tag}")
    statistics = _EmbodimentStatistics(stats, (tag,), config.evidence_of("processor_kwargs", "use_percentiles"))
    steps = config.get(list, *path, tag, "action", "delta_indices", default=[])
    video_indices = config.get(list, *path, tag, "video", "delta_indices", default=[0])
    return TrainedModel(
        framework=NAME,
        about=f"a policy of Isaac-GR00T for {tag}",
        family=certain("vla", config.evidence_of("processor_class")),
        views=[
            _view(name, config.evidence_of(*path, tag, "video", "modality_keys", what=name)) for name in groups["video"]
        ],
        states=[
            statistics.vector(group, config.evidence_of(*path, tag, "state", "modality_keys", what=group))
            for group in groups["state"]
        ],
        action=statistics.answer(groups["action"], config.evidence_of(*path, tag, "action", "modality_keys")),
        reference=_reference(config, (*path, tag, "action", "action_configs")),
        chunk=certain(
            len(steps), config.evidence_of(*path, tag, "action", "delta_indices", what=f"{len(steps)} delta_indices")
        )
        if steps
        else UnknownFact("number of actions in a chunk: the action has no delta_indices"),
        sampling=likely("seeded", Evidence(f"{CODE}/model", None, "the action head draws noise (flow matching)")),
        instruction=_instruction(groups["language"], config.evidence_of(*path, tag, "language", "modality_keys")),
        history=_history(video_indices, config.evidence_of(*path, tag, "video", "delta_indices")),
        robot=certain(tag, config.evidence_of(*path, tag, what=f"embodiment tag {tag}")),
        upstream=upstream("NVIDIA/Isaac-GR00T", "Apache-2.0"),
        code=_code(config.get(bool, "processor_kwargs", "formalize_language", default=False), config),
    )


def _read_metadata(folder: CheckpointFolder, key: str | None) -> TrainedModel:
    meta = folder.json(_OLDER)
    tag = meta.choose_entry(meta.get(dict), key)
    modalities = (tag, "modalities")
    config = folder.json("config.json") if folder.has("config.json") else None
    steps = config.get(int, "action_horizon", default=0) if config else 0
    head = ("action_head_cfg", "action_horizon")
    if config and not steps:
        steps = config.get(int, *head, default=0)
    groups = {kind: list(meta.get(dict, *modalities, kind, default={})) for kind in (*_KINDS, "video")}
    absolute = [meta.get(bool, *modalities, "action", name, "absolute", default=False) for name in groups["action"]]
    where = meta.evidence_of(*modalities, "action", what=f"absolute: {sum(absolute)} of {len(absolute)} groups")
    own = Evidence(f"{CODE}/model/policy.py", None, "Gr00tPolicy applies the transforms of its data config")
    statistics = _EmbodimentStatistics(meta, (tag, "statistics"), own)
    views = []
    for name in groups["video"]:
        size = meta.numbers(*modalities, "video", name, "resolution") or []
        evidence = meta.evidence_of(*modalities, "video", name, what=f"{name}, resolution {size}")
        views.append(_view(name, evidence, (int(size[1]), int(size[0])) if len(size) == 2 else None))
    return TrainedModel(
        framework=NAME,
        about=f"a policy of Isaac-GR00T for {tag}",
        family=certain("vla", Evidence(_OLDER, None, "metadata of a checkpoint of GR00T")),
        views=views,
        states=[statistics.vector(group, meta.evidence_of(*modalities, "state", group)) for group in groups["state"]],
        action=statistics.answer(groups["action"], where),
        reference=certain("absolute", where)
        if absolute and all(absolute)
        else UnknownFact("what actions are relative to: not all groups are absolute", (where,)),
        chunk=certain(steps, config.evidence_of(*(head if config.at(*head) else ("action_horizon",))))
        if config and steps
        else UnknownFact("number of actions in a chunk: config.json names no action_horizon"),
        sampling=likely("seeded", Evidence(f"{CODE}/model/action_head", None, "flow matching draws noise")),
        instruction={"input": assumed("annotation.human.task_description", "the data config names it; often this")},
        robot=certain(tag, meta.evidence_of(tag, what=f"embodiment tag {tag}")),
        upstream=upstream("NVIDIA/Isaac-GR00T", "Apache-2.0"),
        notes=["the data config (order of the groups, history, normalisation) is selected by name when it is loaded"],
    )


def _view(name: str, where: Evidence, size: tuple[int, int] | None = None) -> ImageSpec:
    eye = Evidence(f"{CODE}/data", None, "video keys are uint8 RGB, (T, H, W, C)")
    rest = {"channels": likely("rgb", eye), "layout": likely("hwc", eye), "dtype": likely("uint8", eye)}
    return ImageSpec(input=certain(f"video.{name}", where), names=[name], evidence=where, size=size, rest=rest)


@dataclass(frozen=True)
class _EmbodimentStatistics:
    """Statistics of one embodiment, by kind and group.

    Attributes:
        file: the statistics file; None if there is none.
        path: keys of the statistics in it.
        own: evidence that the policy's class normalises itself.
    """

    file: ConfigDocument | None
    path: tuple[str, ...]
    own: Evidence

    def vector(self, group: str, where: Evidence) -> VectorSpec:
        """Return one group of the state as an input."""
        return VectorSpec(self._numbers([group], "state", where), certain(f"state.{group}", where), self._normal())

    def answer(self, groups: list[str], where: Evidence) -> VectorSpec:
        """Return all groups of an action, concatenated.

        Raises:
            UserError: there are no groups.
        """
        if not groups:
            raise UserError(f"{where.file}: expected the groups of an action, got none")
        return VectorSpec(self._numbers(groups, "action", where), None, self._normal())

    def _normal(self) -> Fact:
        return certain(None, Evidence(self.own.file, self.own.line, f"{self.own.what}: Gr00tPolicy normalises itself"))

    def _numbers(self, groups: list[str], kind: str, where: Evidence) -> VectorNumbers:
        low: list[float] = []
        high: list[float] = []
        counted: list[tuple[str, int]] = []
        for group in groups:
            path = (*self.path, kind, group)
            ends = [self.file.numbers(*path, key) or [] for key in ("min", "max")] if self.file else [[], []]
            counted.append((group, len(ends[0]) or 1))
            low += ends[0]
            high += ends[1]
        width = sum(count for _, count in counted)
        within = None
        if self.file is not None and len(low) == len(high) == width:
            range_evidence = self.file.evidence_of(*self.path, kind, groups[0], what=f"{kind} min..max")
            within = DataRange(tuple(low), tuple(high), range_evidence)
        width_evidence = Evidence(where.file, where.line, f"{where.what} ({width} numbers)")
        return VectorNumbers(width, width_evidence, names.names_of_groups(counted), where, within)


def _reference(config: ConfigDocument, path: tuple[str, ...]) -> Fact | UnknownFact:
    configs = config.get(list, *path, default=[])
    kinds = {str(entry.get("rep")) for entry in configs if isinstance(entry, dict)}
    where = config.evidence_of(*path, what=f"rep: {', '.join(sorted(kinds)) or 'nothing'}")
    if kinds and kinds <= {"ABSOLUTE", "RELATIVE"}:
        # Gr00tPolicy converts relative actions to absolute ones (unapply_action).
        return likely("absolute", where)
    return UnknownFact("what actions are relative to", (where,))


def _instruction(keys: list[str], where: Evidence) -> dict[str, Tree] | None:
    return {"input": certain(keys[0], where)} if keys else None


def _history(indices: list[object], where: Evidence) -> dict[str, Tree] | None:
    steps = [index for index in indices if isinstance(index, int)]
    if len(steps) < 2:
        return None
    strides = {b - a for a, b in pairwise(steps)}
    stride = strides.pop() if len(strides) == 1 else 0
    if stride < 1:
        return {"length": UnknownFact("video delta_indices are not evenly spaced", (where,))}
    return {"length": certain(len(steps), where), "stride": certain(stride, where), "of": ["images"]}


def _code(formal: bool, config: ConfigDocument) -> list[Fact]:  # noqa: FBT001 - a value of the file
    if not formal:
        return []
    where = config.evidence_of("processor_kwargs", "formalize_language")
    return [certain("the processor lower-cases the instruction and removes punctuation", where)]
