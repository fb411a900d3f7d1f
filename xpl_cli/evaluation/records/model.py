"""The content of a record as objects: the plan, and an attempt at an episode (spec/v1/record.schema.json).

Lines are validated against the schema before they are parsed, so that required keys exist. None stands for an optional
key that is missing. tests/evaluation/test_model.py compares the fields with the schema.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Self

from xpl import _spec as sdk
from xpl_cli.evaluation.records.fingerprints import LoadedCheckpoint, digest_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.contract import Config
    from xpl_cli.evaluation.records.lines import Line

SCHEMA: Final = "xpl.record/1"
CellKey = tuple[str, str]
"""Task and setting."""
EpisodeKey = tuple[str, str, int]
"""Task, setting and seed."""


@dataclass(frozen=True)
class PlannedPolicy:
    """The adapter that is evaluated.

    Attributes:
        name: of the package.
        spec: version of the standard that it declares.
        digest: of its own files.
        config: deploy.yml with overrides, and the run mode (`run_mode`).
        checkpoint: None if none was declared or found.
    """

    name: str
    spec: str
    digest: str
    config: Config
    checkpoint: LoadedCheckpoint | None = None

    @property
    def variant(self) -> str | None:
        """The variant of policy.yml that is evaluated; None for the policy itself."""
        variant: str | None = self.config.get(sdk.Deploy.VARIANT)
        return variant

    @property
    def weights(self) -> str | None:
        """Digest of the checkpoint; None without one."""
        return None if self.checkpoint is None else self.checkpoint.digest


@dataclass(frozen=True)
class PlannedEnvironment:
    """The environment of a run: name, version of the standard, digest of the package's own files."""

    name: str
    spec: str
    digest: str


@dataclass(frozen=True)
class Control:
    """How rollouts are run, as far as results depend on it.

    Attributes:
        horizon: execution horizon, at most; None leaves it to the adapter's loop.
        attempts: attempts at an episode at most, if infrastructure errors end them.
    """

    horizon: int | None
    attempts: int


@dataclass(frozen=True)
class PlannedCell:
    """The episodes of one task in one setting.

    Attributes:
        task, setting: of the environment.
        dimension: capability that the task tests.
        seeds: of the episodes, in order.
        frozen: whether these are the environment's evaluation seeds.
    """

    task: str
    setting: str
    dimension: str | None
    seeds: Sequence[int]
    frozen: bool

    @property
    def cell_key(self) -> CellKey:
        """Task and setting."""
        return self.task, self.setting


@dataclass(frozen=True)
class PlannedEpisode:
    """An episode of a plan.

    Attributes:
        index: the episode's key.
        cell: index of its cell in the plan.
        task, setting, seed: of the episode.
    """

    index: int
    cell: int
    task: str
    setting: str
    seed: int

    @property
    def episode_key(self) -> EpisodeKey:
        """Task, setting and seed."""
        return self.task, self.setting, self.seed


@dataclass(frozen=True)
class RunPlan:
    """The plan of a run, fixed before its first episode.

    Attributes:
        policy, environment, embodiment, action_type, control, cells: what is run, and how.
        until_width: a cell ends once the 95 % interval of its success rate is no wider; None: all seeds are run.
        run: digest of everything but `created`, the name of the run.
        created: creation time, UTC.
    """

    policy: PlannedPolicy
    environment: PlannedEnvironment
    embodiment: str
    action_type: str
    control: Control
    cells: Sequence[PlannedCell]
    until_width: float | None = None
    run: str = ""
    created: str = ""

    @classmethod
    def parse(cls, line: Line) -> Self:
        """Return the plan that the first line of a record describes."""
        policy, checkpoint = line["policy"], line["policy"]["checkpoint"]
        fields = {key: value for key, value in line.items() if key not in ("kind", "schema")}
        fields["policy"] = PlannedPolicy(**{**policy, "checkpoint": checkpoint and LoadedCheckpoint(**checkpoint)})
        fields["environment"] = PlannedEnvironment(**line["environment"])
        fields["control"] = Control(**line["control"])
        fields["cells"] = [PlannedCell(**cell) for cell in line["cells"]]
        return cls(**fields)

    def as_json(self) -> Line:
        """Return the first line of a record."""
        return {"kind": "run", "schema": SCHEMA, **asdict(self)}

    def named(self) -> Self:
        """Return the plan of a new run: with its name, and the present time."""
        return replace(self, run=name_of(self.as_json()), created=now())

    def plays_the_same(self, other: RunPlan) -> bool:
        """Return whether two plans are equal, whenever they were made."""
        return replace(self, run="", created="") == replace(other, run="", created="")

    def slots(self) -> list[PlannedEpisode]:
        """Return the episodes, each at its index."""
        seeds = ((number, cell, seed) for number, cell in enumerate(self.cells) for seed in cell.seeds)
        return [
            PlannedEpisode(index, number, cell.task, cell.setting, seed)
            for index, (number, cell, seed) in enumerate(seeds)
        ]


def name_of(line: Line) -> str:
    """Return the name of the run whose first line this is."""
    return digest_of({key: value for key, value in line.items() if key not in ("run", "created")})


def now() -> str:
    """Return the time, UTC, as records have it."""
    return dt.datetime.now(dt.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


@dataclass(frozen=True)
class Inference:
    """Round trips of get_action as the environment's side saw them.

    Attributes:
        count: how many.
        seconds: all together.
        histogram: counts in the bins of 1 ms * 2^(k/2), k = 0 .. 31; the first and the last are open.
    """

    count: int
    seconds: float
    histogram: Sequence[int] | None = None


@dataclass(frozen=True)
class RecordedFile:
    """A file beside the record: its path below the run's folder, and its digest."""

    path: str
    digest: str


@dataclass(frozen=True, kw_only=True)
class AttemptKey:
    """Which attempt at which episode: the episode's key, its place in the plan, and whether another one follows."""

    index: int
    attempt: int
    final: bool
    task: str
    setting: str
    seed: int
    embodiment: str
    action_type: str


@dataclass(frozen=True, kw_only=True)
class EpisodeOutcome:
    """How an attempt ended.

    Attributes:
        success: None if the environment defines none, or after an infrastructure error.
        score: 0 to 1.
        failure: `task`, `policy`, `infrastructure`, or None.
        end_reason: `success`, `max_steps`, the reason of a guard, or the environment's own reason.
        error: a sentence, if policy or infrastructure failed.
        instruction: of the policy.
        layout: initial poses of the objects.
        stages: which were reached.
        steps: executed control steps.
        corrections: number of corrected steps by kind of correction.
        safety: corrections of a guard.
        digest: of all states.
    """

    success: bool | None = None
    score: float | None = None
    failure: str | None = None
    end_reason: str | None = None
    error: str | None = None
    instruction: str | None = None
    layout: Mapping[str, Any] | None = None
    stages: Mapping[str, bool] | None = None
    steps: int | None = None
    corrections: Mapping[str, int] | None = None
    safety: Mapping[str, Any] | None = None
    digest: str | None = None


@dataclass(frozen=True, kw_only=True)
class AttemptExecution:
    """When and where an attempt ran, and for how long.

    Attributes:
        started: UTC.
        wall_seconds: duration.
        worker: host and number of the rollout worker.
        server: instance of the policy server.
        containment: isolation of the adapter from the process that judges it: `isolated`, `apart`, or `trusted` if the
            system supports neither.
        inference: round trips to the server.
    """

    started: str
    wall_seconds: float
    worker: str | None = None
    server: str | None = None
    containment: str | None = None
    inference: Inference | None = None


@dataclass(frozen=True, kw_only=True)
class EpisodeRecord(AttemptExecution, EpisodeOutcome, AttemptKey):
    """One attempt at one episode, as it is recorded; the last attempt is final, and the only one that counts.

    Attributes:
        machine: digest of the machine's facts.
        trace: curves, an .npz.
        film: an animated WebP.
    """

    machine: str
    trace: RecordedFile | None = None
    film: RecordedFile | None = None

    @classmethod
    def parse(cls, line: Line) -> Self:
        """Return the episode that a line of a record describes."""
        fields = {key: value for key, value in line.items() if key != "kind"}
        for name, kind in _PARTS.items():
            if name in fields:
                fields[name] = kind(**fields[name])
        return cls(**fields)

    def as_json(self) -> Line:
        """Return the line of a record; of what need not be there it has what is known, or may be null."""
        fields = {name: value for name, value in vars(self).items() if value is not None or name in _NULL}
        for name in _PARTS.keys() & fields.keys():
            fields[name] = {key: value for key, value in vars(fields[name]).items() if value is not None}
        return {"kind": "episode", **fields}

    @property
    def cell_key(self) -> CellKey:
        """Task and setting."""
        return self.task, self.setting

    @property
    def episode_key(self) -> EpisodeKey:
        """Task, setting and seed."""
        return self.task, self.setting, self.seed


_PARTS: Final[dict[str, type]] = {"inference": Inference, "trace": RecordedFile, "film": RecordedFile}
_NULL: Final = frozenset(
    ("success", "score", "failure", "end_reason", sdk.Obs.INSTRUCTION, "layout", "digest", "worker", "server")
)
"""Of an episode's line: what may be null."""
