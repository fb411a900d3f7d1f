"""A checkpoint of LeRobot: `config.json`, the two processors and their statistics, with or without its data set.

Source: huggingface/lerobot src/lerobot/configs/policies.py (PreTrainedConfig), policies/*/configuration_*.py and
processor/ there. The model's inputs are those of LeRobot's policy class (`predict_action_chunk`), so that what the
class does itself, such as letterboxing in pi0 and SmolVLA, is not in the block.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from xpl_cli.adopt.checkpoints.layout import Numbers, Range
from xpl_cli.adopt.checkpoints.makers.lerobot import statistics
from xpl_cli.adopt.checkpoints.makers.lerobot.types import CODE, LICENSE, REPOSITORY, TYPES, Type
from xpl_cli.adopt.checkpoints.reading import Document
from xpl_cli.adopt.checkpoints.trained import Trained, Vector, View, upstream
from xpl_cli.adopt.facts import Evidence, Open, Told, Tree, assumed, certain, likely
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.makers.lerobot.dataset import Dataset
    from xpl_cli.adopt.checkpoints.makers.lerobot.statistics import Statistics
    from xpl_cli.adopt.checkpoints.reading import Folder

NAME: Final = "lerobot"
CONFIG: Final = "config.json"
_BEFORE: Final = "policy_preprocessor.json"
_AFTER: Final = "policy_postprocessor.json"
_TRAINING: Final = "train_config.json"
_STATE: Final = "observation.state"
_ACTION: Final = "action"
_EMPTY: Final = "empty_camera"
_SAME: Final = 0.5
"""Share of a state's range that an absolute command's range has at least; deltas to the state have far less."""


def inner(folder: Folder) -> Folder | None:
    """Return the folder that holds config.json: this one, or where training put it; None if it is not LeRobot's."""
    for name in ("", "pretrained_model", "checkpoints/last/pretrained_model"):
        place = folder.below(name) if name else folder
        if place.has(CONFIG) and _is_policy(place.json(CONFIG)):
            return place
    return None


def read(folder: Folder, data: Dataset | None = None) -> Trained:
    """Return what a checkpoint says.

    Args:
        folder: which holds config.json.
        data: the data set that it was trained on.

    Raises:
        UserError: if a file is not what it should be.
    """
    return _Reader(folder, data).trained()


def _is_policy(config: Document) -> bool:
    shapes = all(isinstance(config.at(f"{which}_shapes"), dict) for which in ("input", "output"))
    features = any(isinstance(config.at(f"{which}_features"), dict) for which in ("input", "output"))
    return shapes or (features and isinstance(config.at("type"), str))


class _Reader:
    def __init__(self, folder: Folder, data: Dataset | None) -> None:
        self.folder, self.data = folder, data
        self.config = folder.json(CONFIG)
        self.type = self.config.get(str, "type", default="")
        self.known: Type | None = TYPES.get(self.type)
        older = statistics.of_weights(folder, self.config) if not folder.has(_BEFORE) else None
        self.before = statistics.of_processor(folder, _BEFORE, "normalizer_processor") or older
        self.after = statistics.of_processor(folder, _AFTER, "unnormalizer_processor") or older
        self.steps = folder.json(_BEFORE) if folder.has(_BEFORE) else Document(_BEFORE, {})
        self.notes: list[str] = []
        self.exempt: list[bool] = []
        if older is not None:
            self.notes.append(
                "the checkpoint has no processors: LeRobot 0.4 and newer want them; its "
                "src/lerobot/processor/migrate_policy_normalization.py makes them from these weights"
            )
        elif self.before is None:
            self.notes.append("the checkpoint has neither processors nor statistics in its weights: say normalize")

    def trained(self) -> Trained:
        config = self.config
        where = config.seen("type") if self.type else Evidence(CONFIG, None, "no type")
        inputs, outputs = self._features("input"), self._features("output")
        if _ACTION not in outputs:
            raise UserError(
                f"{self.folder.path / CONFIG}: expected output_features with {_ACTION!r}, got {list(outputs)}"
            )
        if self.data is None:
            self._where_the_data_is()
        return Trained(
            maker=NAME,
            about=f"a policy of LeRobot, {self.type or 'of an unknown type'}",
            family=certain(self.known.family, where) if self.known else assumed("other", f"LeRobot's {self.type}"),
            views=[
                self._view(name, shape)
                for name, (kind, shape) in inputs.items()
                if kind == "VISUAL" and _EMPTY not in name
            ],
            states=[self._state(name, shape) for name, (kind, shape) in inputs.items() if kind in ("STATE", "ENV")],
            action=self._action(outputs[_ACTION][1]),
            reference=self._reference(outputs[_ACTION][1]),
            chunk=self._chunk(),
            sampling=self._sampling(),
            recurrent=likely(self.known.recurrent, _code(self.known)) if self.known and self.known.recurrent else None,
            instruction=self._instruction(),
            history=self._history(),
            ensembling=self._ensembling(),
            rate=self.data.rate if self.data else None,
            robot=self.data.robot if self.data else None,
            upstream=upstream(REPOSITORY, LICENSE),
            exempt=self.exempt,
            notes=self.notes,
        )

    def _features(self, which: str) -> dict[str, tuple[str, list[int]]]:
        """Return name to kind and shape of inputs or outputs; older checkpoints have shapes only."""
        found: dict[str, tuple[str, list[int]]] = {}
        for name, entry in self.config.get(dict, f"{which}_features", default={}).items():
            path = (f"{which}_features", name)
            kind = self.config.get(str, *path, "type")
            shape = [int(one) for one in self.config.numbers(*path, "shape") or []]
            found[name] = (kind, shape)
            if not shape or not isinstance(entry, dict):
                raise UserError(f"{self.config.place(*path)}: expected a shape of {name}, got {str(entry)[:60]}")
        for name in self.config.get(dict, f"{which}_shapes", default={}):
            shape = [int(one) for one in self.config.numbers(f"{which}_shapes", name) or []]
            kind = (
                "VISUAL" if "image" in name else "ACTION" if name == _ACTION else "STATE" if name == _STATE else "ENV"
            )
            found.setdefault(name, (kind, shape))
        return found

    def _at(self, which: str, name: str) -> Evidence:
        key = f"{which}_features" if self.config.at(f"{which}_features", name) is not None else f"{which}_shapes"
        return Evidence(CONFIG, self.config.line(key, name), name)

    # -- inputs --------------------------------------------------------------------------------------------------------

    def _view(self, name: str, shape: list[int]) -> View:
        where = self._at("input", name)
        steps: list[Tree] = []
        size = (shape[1], shape[2]) if len(shape) == 3 else None
        resizes = bool(self.known and self.known.resizes)
        if size and not resizes:
            told = Evidence(CONFIG, self.config.line("input_features", name, "shape"), f"shape: {shape}")
            why = "LeRobot resizes no image of another size itself; torch's bilinear filter, with antialias"
            steps.append(
                {
                    "resize": {
                        "to": certain(list(size), told),
                        "filter": assumed("bilinear", why),
                        "antialias": True,
                        "as": "float",
                    }
                }
            )
        renamed = self._renamed(name)
        if renamed:
            where = Evidence(where.file, where.line, f"{name}, renamed from {renamed}")
        rest: dict[str, Tree] = {
            "channels": likely("rgb", Evidence(f"{CODE}/cameras", None, "color_mode is RGB by default")),
            "layout": likely("chw", Evidence(f"{CODE}/policies/utils.py", None, "prepare_observation_for_inference")),
            "dtype": likely("float32", Evidence(f"{CODE}/policies/utils.py", None, "type(torch.float32) / 255")),
        }
        if self.before is not None:
            rest |= self.before.colours(name)
        return View(
            input=certain(name, where),
            names=[renamed or name],
            evidence=where,
            size=None if resizes else size,
            steps=steps,
            rest=rest,
        )

    def _renamed(self, name: str) -> str:
        """Return what the data called an image that a processor renames."""
        steps = self.steps.get(list, "steps", default=[])
        for index, _ in enumerate(steps):
            names = self.steps.get(dict, "steps", index, "config", "rename_map", default={})
            if before := [str(key) for key, value in names.items() if value == name]:
                return before[0]
        return ""

    def _state(self, name: str, shape: list[int]) -> Vector:
        numbers = self._numbers("input", name, shape, self.before)
        normalize = self.before.rule(name, "STATE" if name == _STATE else "ENV") if self.before else self._no_rule()
        parts = None
        if name != _STATE:
            reason = f"{name} is what a simulator knows, and no observation of the standard holds"
            parts = Open(reason, (self._at("input", name),))
        return Vector(numbers, certain(name, self._at("input", name)), normalize, parts=parts)

    def _numbers(self, which: str, name: str, shape: list[int], held: Statistics | None) -> Numbers:
        names = self.data.names(name) if self.data else None
        found = self._action_names() if name == _ACTION and names is None else names
        within: Range | None = held.range(name) if held else None
        within = within or (self.data.range(name) if self.data else None)
        if within is not None and len(within.low) != shape[0]:
            within = None
        return Numbers(
            width=shape[0],
            evidence=self._at(which, name),
            names=found[0] if found else (),
            named=found[1] if found else None,
            range=within,
        )

    def _instruction(self) -> dict[str, Tree] | None:
        steps = self.steps.get(list, "steps", default=[])
        reads = [step for step in steps if isinstance(step, dict) and "token" in str(step.get("registry_name"))]
        if not reads and (self.known is None or self.known.family != "vla"):
            return None
        where = Evidence(_BEFORE, None, str(reads[0].get("registry_name"))) if reads else self.config.seen("type")
        blank = Evidence(f"{CODE}/policies/utils.py", None, 'task if task else ""')
        return {"input": likely("task", where), "empty": likely("blank", blank)}

    def _history(self) -> dict[str, Tree] | None:
        length = self.config.get(int, "n_obs_steps", default=1)
        if length <= 1:
            return None
        queues = Evidence(f"{CODE}/policies/utils.py", None, "populate_queues copies the first observation")
        return {"length": certain(length, self.config.seen("n_obs_steps")), "pad": likely("repeat", queues)}

    # -- answers -------------------------------------------------------------------------------------------------------

    def _action(self, shape: list[int]) -> Vector:
        normalize = self.after.rule(_ACTION, "ACTION") if self.after else self._no_rule()
        return Vector(self._numbers("output", _ACTION, shape, self.after), None, normalize)

    def _no_rule(self) -> Open:
        return Open(
            "the checkpoint holds neither processors nor statistics in its weights", (self.config.seen("type"),)
        )

    def _reference(self, shape: list[int]) -> Told | Open:
        steps = self.steps.get(list, "steps", default=[])
        for index, step in enumerate(steps):
            if isinstance(step, dict) and step.get("registry_name") == "relative_actions_processor":
                enabled = self.steps.get(bool, "steps", index, "config", "enabled", default=False)
                kept = self.steps.texts("steps", index, "config", "exclude_joints") or []
                where = Evidence(_BEFORE, self.steps.line("steps", "config", "enabled"), f"enabled: {enabled}")
                if enabled:
                    names = self.steps.texts("steps", index, "config", "action_names") or []
                    self.exempt = _exempt(shape[0], kept, names)
                    return certain("delta_state", where)
        if self.config.get(bool, "use_delta_joint_actions_aloha", default=False):
            return certain("delta_state", self.config.seen("use_delta_joint_actions_aloha"))
        return self._by_ranges(shape)

    def _by_ranges(self, shape: list[int]) -> Told | Open:
        """Return what actions are counted from, by how far they and the states of the data reach."""
        states, actions = (
            held.range(name) if held else None for held, name in ((self.before, _STATE), (self.after, _ACTION))
        )
        if states is None or actions is None or len(states.low) != shape[0] or len(actions.low) != shape[0]:
            return assumed("absolute", "LeRobot records commands as they are sent to the robot")
        wide = [
            high - low >= _SAME * (top - bottom)
            for low, high, bottom, top in zip(actions.low, actions.high, states.low, states.high, strict=True)
            if top > bottom
        ]
        told = f"{sum(wide)} of {len(wide)} commands reach as far as the state does"
        where = Evidence(actions.evidence.file, None, told)
        if wide and sum(wide) >= 0.8 * len(wide):
            return likely("absolute", where)
        return Open("absolute, or deltas to the state: commands reach less far than the state", (where,))

    def _chunk(self) -> Told | Open:
        key = self.known.horizon if self.known else "n_action_steps"
        if self._ensembling() is not None:
            key = "chunk_size"
        for name in (key, "n_action_steps", "chunk_size", "horizon"):
            if (steps := self.config.get(int, name, default=0)) > 0:
                return certain(steps, self.config.seen(name))
        return Open("how many steps an answer has: config.json names no n_action_steps", (self.config.seen("type"),))

    def _ensembling(self) -> Told | None:
        decay: float | None = self.config.get(float, "temporal_ensemble_coeff", default=None)
        return None if decay is None else certain(decay, self.config.seen("temporal_ensemble_coeff"))

    def _sampling(self) -> Told | Open:
        if self.known is None:
            return Open(
                f"none, seeded or free: LeRobot's type {self.type!r} is not known here", (self.config.seen("type"),)
            )
        temperature = self.config.get(float, "temperature", default=0.0)
        if self.type == "pi0_fast" and temperature:
            return certain("seeded", self.config.seen("temperature"))
        return likely(self.known.sampling, _code(self.known))

    # -- the data set --------------------------------------------------------------------------------------------------

    def _action_names(self) -> tuple[list[str], Evidence] | None:
        """Return the names of an answer's numbers, where a checkpoint keeps them."""
        for path in (("action_feature_names",), ("dataset_feature_names", _ACTION)):
            if (found := self.config.texts(*path)) is not None:
                return found, Evidence(CONFIG, self.config.line(*path), path[0])
        return None

    def _where_the_data_is(self) -> None:
        told: Any = None
        if self.folder.has(_TRAINING):
            told = self.folder.json(_TRAINING).at("dataset", "repo_id")
        named = f" ({told})" if isinstance(told, str) else ""
        self.notes.append(
            f"names of joints, grippers and cameras, the rate and the robot are in the data set{named}: "
            "give its folder with a second --from"
        )


def _exempt(width: int, kept: list[str], names: list[str]) -> list[bool]:
    """Return for each number of an action whether it stays absolute (RelativeActionsProcessorStep._build_mask)."""
    words = [word.lower() for word in kept if word]
    if not words or not names:
        return [False] * width
    found = [any(word in name.lower() for word in words) for name in names[:width]]
    return [*found, *[False] * (width - len(found))]


def _code(known: Type) -> Evidence:
    """Return where LeRobot's own code says what a type does."""
    file, _, what = known.why.partition(": ")  # with its line
    return Evidence(f"{CODE}/{file}", None, what)
