"""Base class of the checks of a dataset, and the data of an episode that each check gets."""

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
"""Most episodes that a finding names; of the others it gives the number."""


@dataclass(frozen=True)
class CameraFrames:
    """Images of a camera in one episode.

    Attributes:
        count: number of images; None where they were not decoded.
        first: the first image, downscaled, (h, w, 3) uint8; None if there is none.
        repeats: (N - 1,) bool: for each image but the first whether it equals the one before it.
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
        length: number of steps that the dataset declares.
        instructions: in natural language.
        columns: by name (T, D) float64; those that are not numbers are missing.
        shapes: by name the shape of a row.
        cameras: images by camera.
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
    """What is known of the whole dataset.

    Attributes:
        format: name of its format.
        robot: name of the embodiment, None if it is unknown.
        found: result of `xpl data probe`: which numbers are joints, grippers, rotations.
    """

    format: str
    robot: str | None
    found: ProbeResult


class DemonstrationCheck(ABC):
    """One check of a dataset: it gets one episode after the other, and keeps only what it needs of each.

    `xpl explain` prints the docstring of a check. `severity` is `must` or `should`.
    """

    code: ClassVar[str]
    slug: ClassVar[str]
    severity: ClassVar[str]
    gate: ClassVar[DataGate] = DataGate.DATA
    target: ClassVar[str] = "demonstrations"
    requirement: ClassVar[str] = ""
    needs_images: ClassVar[bool] = False
    """Whether it needs decoded images."""
    needs_probe: ClassVar[bool] = False
    """Whether it needs the probe: which numbers are joints, grippers and rotations."""
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
        """Count an episode and inspect it.

        Raises:
            NotApplicable: the check does not apply to this dataset.
        """
        self.tally.episodes += 1
        self.inspect(episode)

    @abstractmethod
    def inspect(self, episode: EpisodeData) -> None:
        """Inspect an episode, and add problems to `tally`."""

    def findings(self) -> Iterator[Finding]:
        """Yield findings after the last episode; by default those of `tally`.

        Raises:
            NotApplicable: the check does not apply to this dataset.
        """
        yield from self.tally.findings()


@dataclass
class EpisodeTally:
    """Episodes by problem: one finding for each problem, not one for each episode."""

    counts: dict[str, list[str]] = field(default_factory=dict)
    episodes: int = 0

    def add(self, what: str, where: str) -> None:
        """Add a problem in an episode, at a location such as `episode_3 (step 12)`."""
        self.counts.setdefault(what, []).append(where)

    def findings(self, *, must: bool | None = None, expected: str | None = None) -> Iterator[Finding]:
        """Yield one finding for each problem."""
        for what, where in self.counts.items():
            message = f"{what}, in {len(where)} of {self.episodes} episodes: {join_limited(where, MOST_NAMED)}"
            yield Finding(message, expected=expected, evidence={"episodes": len(where), "of": self.episodes}, must=must)
