"""Manifests as objects: what policy.yml and env.yml say, read once where a file or a message comes in.

A key that is missing, or whose value has another type, has its default here: the schema says what is wrong with a
document (`xpl spec validate`), and no reader has to ask again. tests/sdk/test_manifest.py holds the fields and defaults
against `spec/`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Callable, TypeVar

from xpl import robots
from xpl._spec import MODEL_CLASS

__all__ = [
    "CameraNeeds",
    "Checkpoint",
    "CheckpointFile",
    "Claim",
    "Document",
    "EnvManifest",
    "Gripper",
    "GripperValues",
    "HandOver",
    "History",
    "Inputs",
    "Manifest",
    "Native",
    "PythonEnvironment",
    "ResultFile",
    "SeedRange",
    "Serving",
    "Shadow",
    "Task",
    "Temporal",
    "Waiver",
    "Workspace",
]

_READER = "reader"
_DocumentT = TypeVar("_DocumentT", bound="Document")


class Document:
    """What is filled from a map as YAML or JSON has it."""

    @classmethod
    def parse(cls: type[_DocumentT], data: object) -> _DocumentT:  # noqa: PYI019 - Python 3.9 has no Self
        """Return the object that a map describes; anything else than a map counts as an empty one."""
        known: Mapping[Any, Any] = data if isinstance(data, Mapping) else {}
        declared = fields(cls)  # type: ignore[arg-type]
        found = {item.name: item.metadata[_READER](known.get(item.name)) for item in declared if item.metadata}
        values = {name: value for name, value in found.items() if value is not None}
        if any(item.name == "data" for item in declared):
            values["data"] = known
        return cls(**values)


def _one(kind: type, default: Any = None) -> Any:
    """Declare a value of one type; true and false are no numbers, and a whole number may stand for a float."""
    return field(default=default, metadata={_READER: _reader(kind)})


def _many(kind: type, default: tuple[Any, ...] = ()) -> Any:
    """Declare a list, as a tuple of what has the type."""
    one = _reader(kind)

    def reader(value: object) -> tuple[Any, ...] | None:
        if not isinstance(value, Sequence) or isinstance(value, (str, bytes)):
            return None
        return tuple(made for item in value if (made := one(item)) is not None)

    return field(default=default, metadata={_READER: reader})


def _named(kind: type) -> Any:
    """Declare a map from names to what has the type."""
    one = _reader(kind)

    def reader(value: object) -> dict[str, Any] | None:
        if not isinstance(value, Mapping):
            return None
        return {str(name): made for name, item in value.items() if (made := one(item)) is not None}

    return field(default_factory=dict, metadata={_READER: reader})


def _part(kind: type) -> Any:
    """Declare a part that has its own defaults where the map does not have it."""
    return field(default_factory=kind, metadata={_READER: _reader(kind)})


def _reader(kind: type) -> Callable[[object], Any]:
    if issubclass(kind, Document):
        return lambda value: kind.parse(value) if isinstance(value, Mapping) else None
    if kind is float:
        return lambda value: value if isinstance(value, (int, float)) and not isinstance(value, bool) else None
    if kind is int:
        return lambda value: value if isinstance(value, int) and not isinstance(value, bool) else None
    return lambda value: value if isinstance(value, kind) else None


@dataclass(frozen=True)
class Temporal(Document):
    """How past and future enter. `history` counts observations, `chunk` action steps of one answer."""

    kind: str | None = _one(str)
    chunk: int | None = _one(int)
    history: int = _one(int, 1)
    ensembling: float | None = _one(float)


@dataclass(frozen=True)
class Inputs(Document):
    """Observation fields by name (`state.ee_pose`, `vision.cam_head`): needed, used where there, ignored."""

    required: tuple[str, ...] = _many(str)
    optional: tuple[str, ...] = _many(str)
    unused: tuple[str, ...] = _many(str)

    @property
    def read(self) -> tuple[str, ...]:
        """The fields that the policy uses."""
        return (*self.required, *self.optional)


@dataclass(frozen=True)
class CheckpointFile(Document):
    """One file of a checkpoint: relative path, SHA-256 and bytes where declared."""

    path: str = _one(str, "")
    sha256: str | None = _one(str)
    size: int | None = _one(int)


@dataclass(frozen=True)
class Checkpoint(Document):
    """Weights that `xpl checkpoint fetch` brings; `data` is the entry as it is written."""

    name: str = _one(str, "")
    source: str = _one(str, "")
    revision: str | None = _one(str)
    sha256: str | None = _one(str)
    size: int | None = _one(int)
    license: str | None = _one(str)
    files: tuple[CheckpointFile, ...] = _many(CheckpointFile)
    data: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)


@dataclass(frozen=True)
class PythonEnvironment(Document):
    """Where a package's interpreter comes from; manager `none` is the tool's own."""

    manager: str = _one(str, "none")
    python: str | None = _one(str)
    name: str | None = _one(str)
    requirements: tuple[str, ...] = _many(str)
    lock: str | None = _one(str)


@dataclass(frozen=True)
class Serving(Document):
    """Whether several clients may share one model, and the largest batch of it (None: no limit)."""

    shared: bool = _one(bool, default=False)
    max_batch: int | None = _one(int)


@dataclass(frozen=True)
class Shadow(Document):
    """What `predict` returns without the model: shape (H, D) and range (low, high); empty where not declared."""

    shape: tuple[int, ...] = _many(int)
    range: tuple[float, ...] = _many(float)


@dataclass(frozen=True)
class Claim(Document):
    """A success rate that the author claims, 0 to 1."""

    environment: str = _one(str, "")
    task: str = _one(str, "")
    embodiment: str | None = _one(str)
    action_type: str | None = _one(str)
    setting: str | None = _one(str)
    success_rate: float = _one(float, 0.0)
    episodes: int | None = _one(int)


@dataclass(frozen=True)
class Waiver(Document):
    """A rule whose findings the author accepts, with the reason."""

    rule: str = _one(str, "")
    reason: str = _one(str, "")
    message: str | None = _one(str)


@dataclass(frozen=True)
class CameraNeeds(Document):
    """The smallest image, in pixels, that a policy can work with; None: any will do. `exact`: this size only."""

    width: int | None = _one(int)
    height: int | None = _one(int)
    exact: bool = _one(bool, default=False)


@dataclass(frozen=True)
class GripperValues(Document):
    """The model's values of a closed and an open gripper, in `unit`."""

    closed: float | None = _one(float)
    open: float | None = _one(float)
    unit: str | None = _one(str)


@dataclass(frozen=True)
class Gripper(Document):
    """What the policy's gripper commands mean: `position` or `binary`."""

    command: str | None = _one(str)
    native: GripperValues | None = _one(GripperValues)


@dataclass(frozen=True)
class History(Document):
    """Earlier observations that the model sees, too; what is open has its default."""

    length: int = _one(int, 1)
    stride: int = _one(int, 1)
    pad: str = _one(str, "repeat")
    mask: str | None = _one(str)
    of: tuple[str, ...] = _many(str, ("images", "state"))

    @property
    def reach(self) -> int:
        """Control steps that it reaches over, the newest observation included."""
        return (self.length - 1) * self.stride + 1


@dataclass(frozen=True)
class Native(Document):
    """What the model itself reads and answers. `xpl.convert` compiles the block as it is written (`data`).

    Attributes:
        sampling, recurrent: a map where the author says that it is unknown.
    """

    images: tuple[Mapping[str, Any], ...] = _many(Mapping)
    state: tuple[Mapping[str, Any], ...] = _many(Mapping)
    instruction: object = _one(object)
    history: History | None = _one(History)
    action: Mapping[str, Any] = _named(object)
    sampling: object = _one(object, "none")
    tolerance: float = _one(float, 0.001)
    recurrent: object = _one(object, default=False)
    samples: tuple[Mapping[str, Any], ...] = _many(Mapping)
    code: tuple[str, ...] = _many(str)
    data: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __bool__(self) -> bool:
        return bool(self.data)

    @property
    def remembered(self) -> tuple[str, ...]:
        """The inputs, `images` and `state`, of which the model sees earlier observations, too."""
        there = {"images": self.images, "state": self.state}
        return () if self.history is None else tuple(name for name in self.history.of if there.get(name))

    @property
    def draws(self) -> bool:
        """Whether the model draws random numbers, or may."""
        return self.sampling != "none"


@dataclass(frozen=True)
class Manifest(Document):
    """policy.yml. One that does not exist has all defaults and is false.

    Attributes:
        inputs: None where the manifest does not say.
        cameras: needs by camera of the standard; None where the manifest does not say.
        native: what the model itself reads and answers; None without a block.
        model_class: class of model.py that is served.
        variants: merge patches by name (`xpl.variants`).
        data: the whole map as it is written.
    """

    spec: str | None = _one(str)
    name: str | None = _one(str)
    summary: str | None = _one(str)
    family: str | None = _one(str)
    paper: Mapping[str, Any] | None = _one(Mapping)
    upstream: Mapping[str, Any] | None = _one(Mapping)
    license: str | None = _one(str)
    temporal: Temporal = _part(Temporal)
    control_frequency: float | None = _one(float)
    inputs: Inputs | None = _one(Inputs)
    embodiments: tuple[str, ...] = _many(str)
    action_types: tuple[str, ...] = _many(str)
    deterministic: bool = _one(bool, default=True)
    evaluation_only: bool = _one(bool, default=False)
    checkpoints: tuple[Checkpoint, ...] = _many(Checkpoint)
    environment: PythonEnvironment = _part(PythonEnvironment)
    model_class: str = _one(str, MODEL_CLASS)
    variants: Mapping[str, Mapping[str, Any]] = _named(Mapping)
    methods: tuple[str, ...] = _many(str)
    serving: Serving = _part(Serving)
    shadow: Shadow = _part(Shadow)
    claims: tuple[Claim, ...] = _many(Claim)
    waivers: tuple[Waiver, ...] = _many(Waiver)
    cameras: Mapping[str, CameraNeeds] = _named(CameraNeeds)
    gripper: Gripper | None = _one(Gripper)
    native: Native | None = _one(Native)
    data: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __bool__(self) -> bool:
        return bool(self.data)

    @property
    def required(self) -> tuple[str, ...]:
        """The inputs without which the policy does not act; none where the manifest does not say."""
        return () if self.inputs is None else self.inputs.required

    @property
    def reach(self) -> int:
        """Control steps that the history reaches over, the newest observation included; 1 without one."""
        of_model = 1 if self.native is None or self.native.history is None else self.native.history.reach
        return max(of_model, self.temporal.history)

    @property
    def read(self) -> tuple[str, ...]:
        """The inputs that the policy uses; none where the manifest does not say."""
        return () if self.inputs is None else self.inputs.read


@dataclass(frozen=True)
class Task(Document):
    """One task of an environment.

    Attributes:
        stages: score by stage; empty where only success counts.
        arms: numbers of arms with which it can be played; empty for all.
        unsupported: reason by robot that it is not offered with.
        control_frequency: Hz, where it is not the environment's.
        data: the whole entry as it is written, with what only this environment reads.
    """

    instruction: str = _one(str, "")
    max_steps: int = _one(int, 0)
    stages: Mapping[str, float] = _named(float)
    dimension: str | None = _one(str)
    arms: tuple[int, ...] = _many(int)
    unsupported: Mapping[str, str] = _named(str)
    control_frequency: float | None = _one(float)
    success_means: str | None = _one(str)
    data: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)


@dataclass(frozen=True)
class SeedRange(Document):
    """Seeds that a benchmark freezes for its evaluation: `count` of them from `first` on."""

    first: int = _one(int, 0)
    count: int = _one(int, 0)


@dataclass(frozen=True)
class Workspace(Document):
    """A benchmark's folder: the environment variable that names it, and what has to be in it."""

    variable: str = _one(str, "")
    files: tuple[str, ...] = _many(str)


@dataclass(frozen=True)
class ResultFile(Document):
    """Where a benchmark's result lies below its workspace: `*` stands for a name that only the benchmark knows."""

    form: str = _one(str, "")
    file: str = _one(str, "")


@dataclass(frozen=True)
class HandOver(Document):
    """How a benchmark's own evaluation is launched (docs/hand-over.md).

    Attributes:
        bench_name: as launchers and deploy.yml call the benchmark.
        command: words that launch it; it runs in the workspace.
        rehearsal: words that play a stand-in of it; empty where there is none.
        variables: environment variables of the command.
        randomized: how names of tasks of the randomized setting end; None where names do not tell.
    """

    bench_name: str = _one(str, "")
    workspace: Workspace = _part(Workspace)
    command: tuple[str, ...] = _many(str)
    rehearsal: tuple[str, ...] = _many(str)
    variables: Mapping[str, str] = _named(str)
    result: ResultFile = _part(ResultFile)
    randomized: str | None = _one(str)


@dataclass(frozen=True)
class EnvManifest(Document):
    """env.yml.

    Attributes:
        cameras: properties by camera of the standard, as they are written.
        any_embodiment: it suits every robot, not only those listed.
        real_time: time goes on while a policy thinks; None where the manifest does not say.
        expert: the policy that solves its tasks, where one comes along.
        splits: task names by the benchmark's own lists.
        evaluation_seeds: None where nothing is frozen.
        hand_over: how the benchmark's own evaluation script is called; None without one.
        stand_in: what it replaces, and how it differs; None where the benchmark's own code plays.
        robot: how a real arm is driven with care (`xpl.arms.Care`); None for a simulation.
        data: the whole map as it is written, with what only this environment reads.
    """

    spec: str | None = _one(str)
    name: str = _one(str, "")
    title: str = _one(str, "")
    summary: str | None = _one(str)
    client: str = _one(str, "client.py")
    embodiments: tuple[str, ...] = _many(str)
    any_embodiment: bool = _one(bool, default=False)
    action_types: tuple[str, ...] = _many(str)
    cameras: Mapping[str, Mapping[str, Any]] = _named(Mapping)
    control_frequency: float = _one(float, 0.0)
    real_time: bool | None = _one(bool)
    pose_frame: str | None = _one(str)
    privileged: bool = _one(bool, default=False)
    scripted: bool = _one(bool, default=False)
    settings: tuple[str, ...] = _many(str, ("clean",))
    renderers: tuple[str, ...] = _many(str)
    environment: PythonEnvironment = _part(PythonEnvironment)
    expert: str | None = _one(str)
    splits: Mapping[str, Sequence[str]] = _named(list)
    evaluation_seeds: SeedRange | None = _one(SeedRange)
    success_means: str | None = _one(str)
    hand_over: HandOver | None = _one(HandOver)
    stand_in: str | None = _one(str)
    robot: Mapping[str, Any] | None = _one(Mapping)
    tasks: Mapping[str, Task] = _named(Task)
    data: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def frequency(self, task: str | None) -> float:
        """Return the control rate of a task, Hz: its own, or the environment's."""
        own = None if task is None or task not in self.tasks else self.tasks[task].control_frequency
        return self.control_frequency if own is None else own

    def offers(self, robot: str) -> bool:
        """Tell whether the environment offers a robot, by any of its names, or suits whichever there is."""
        return self.any_embodiment or robot in map(robots.canonical, self.embodiments)

    @property
    def is_real(self) -> bool:
        """Whether a robot may stand behind it: it does not say that it waits, or follows a script."""
        return self.real_time is not False and not self.scripted
