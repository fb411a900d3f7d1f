"""Checks of a set: how one is declared, and what each sees of an episode."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Final

from xpl_cli.audit.rules.gates import DataGate
from xpl_cli.audit.rules.model import Finding
from xpl_cli.basics.phrases import join_limited

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import numpy as np

    from xpl_cli.data.probe.probe import ProbeResult

MOST_NAMED: Final = 5
"""Episodes that a finding names; of more their number is told."""


@dataclass(frozen=True)
class CameraFrames:
    """What was seen of a camera in one episode.

    Attributes:
        count: images that there are; None where they were not looked at.
        first: the first one, made small, (h, w, 3) uint8; None if there is none.
        same: for each image but the first whether it equals the one before it, (N - 1,).
        error: why images cannot be read; "" if they can.
    """

    count: int | None
    first: np.ndarray | None
    repeats: np.ndarray | None
    error: str = ""


@dataclass(frozen=True)
class EpisodeData:
    """One episode.

    Attributes:
        key: its name in the set.
        length: how many steps it says that it has.
        instructions: what the robot was told.
        columns: by name (T, D) float64; those that are not numbers are missing.
        shapes: by name the shape of a row.
        cameras: by name what was seen.
        errors: by column why it cannot be read.
    """

    key: str
    length: int
    instructions: tuple[str, ...]
    columns: Mapping[str, np.ndarray]
    shapes: Mapping[str, tuple[int, ...]]
    cameras: Mapping[str, CameraFrames]
    errors: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class DatasetInfo:
    """What is known of the whole set.

    Attributes:
        format: name of its format.
        robot: name of the embodiment, None if it is unknown.
        found: what a probe measured: which numbers are joints, grippers, rotations.
    """

    format: str
    robot: str | None
    found: ProbeResult


class DemonstrationCheck(ABC):
    """One check of a set: it sees episode after episode, and keeps of each only what it needs.

    The docstring of a check is what `xpl explain` prints. `severity` is `must` or `should`.
    """

    code: ClassVar[str]
    slug: ClassVar[str]
    severity: ClassVar[str]
    gate: ClassVar[DataGate] = DataGate.DATA
    target: ClassVar[str] = "demonstrations"
    requirement: ClassVar[str] = ""
    needs_images: ClassVar[bool] = False
    """Whether it needs images."""
    needs_probe: ClassVar[bool] = False
    """Whether it needs to know which numbers are what."""
    documentation: ClassVar[str] = ""
    """The docstring: a summary line, then sections with fixed headings."""
    summary: ClassVar[str] = ""
    """Its first line."""

    def __init_subclass__(cls) -> None:
        cls.documentation = inspect.getdoc(cls) or ""
        cls.summary = cls.documentation.partition("\n")[0]

    def __init__(self, dataset: DatasetInfo) -> None:
        self.about = dataset
        self.tally = EpisodeTally()

    def take(self, episode: EpisodeData) -> None:
        """Count an episode and look at it.

        Raises:
            NotApplicable: there is nothing to prove on this set.
        """
        self.tally.episodes += 1
        self.inspect(episode)

    @abstractmethod
    def inspect(self, episode: EpisodeData) -> None:
        """Look at an episode, and note in `tally` what is wrong."""

    def findings(self) -> Iterator[Finding]:
        """Yield what is wrong, after the last episode; what was noted by default.

        Raises:
            NotApplicable: there was nothing to prove on this set.
        """
        yield from self.tally.findings()


@dataclass
class EpisodeTally:
    """Episodes in which something is wrong, by what: one finding for each, not one for each episode."""

    counts: dict[str, list[str]] = field(default_factory=dict)
    episodes: int = 0

    def add(self, what: str, where: str) -> None:
        """Note something in an episode, at such as `episode_3 (step 12)`."""
        self.counts.setdefault(what, []).append(where)

    def findings(self, *, must: bool | None = None, expected: str | None = None) -> Iterator[Finding]:
        """Yield a finding for each thing that is wrong."""
        for what, where in self.counts.items():
            message = f"{what}, in {len(where)} of {self.episodes} episodes: {join_limited(where, MOST_NAMED)}"
            yield Finding(message, expected=expected, evidence={"episodes": len(where), "of": self.episodes}, must=must)
