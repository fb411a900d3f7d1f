"""The verdicts on what a manifest declares: its block, its samples, and the robot that they are of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import get_embodiment
from xpl.convert import ConversionError
from xpl.embodiment import UnknownEmbodimentError
from xpl_cli.model_io.kinematics import consistency, samples
from xpl_cli.standard import validate

if TYPE_CHECKING:
    from xpl import Embodiment
    from xpl.manifest import Manifest
    from xpl_cli.model_io.kinematics.consistency import KinematicsVerdict


class NotJudgeableError(Exception):
    """There is nothing to judge; the text says why."""


def judge_samples(manifest: Manifest, folders: Sequence[Path]) -> list[KinematicsVerdict]:
    """Return what kinematics says of a manifest's samples.

    Args:
        manifest: policy.yml.
        folders: where files may lie: the package.

    Raises:
        NoWitnessError: if there are no samples, or no kinematics.
        ConversionError: if samples cannot be read, or do not fit the block or the robot.
    """
    if not manifest.model_io:
        raise NotJudgeableError("policy.yml has no model_io block")
    model_io = manifest.model_io.data
    if validate.validate(model_io, "model_io"):
        raise NotJudgeableError("the model_io block is not what its schema asks for; XPL104 says where")
    if not manifest.model_io.samples:
        raise NotJudgeableError("model_io names no samples: no rows that hold joints and poses together")
    robots = list(_robots(manifest))
    if not robots:
        raise NotJudgeableError("the standard has the joint frames of none of the declared robots")
    first_error = None
    for robot in robots:  # the first that the rows fit
        try:
            columns = samples.collect(model_io, folders, robot)
        except ConversionError as error:
            first_error = first_error or error
            continue
        verdicts = consistency.judge(columns, robot)
        if not verdicts:
            raise NotJudgeableError(
                "model_io.samples hold no joints and poses of one arm, absolute and of the same moments"
            )
        return verdicts
    raise first_error or AssertionError("a robot fits, or an error says why not")


def _robots(manifest: Manifest) -> Iterator[Embodiment]:
    """Yield the declared robots that have kinematics."""
    for name in manifest.embodiments:
        try:
            robot = get_embodiment(name)
        except UnknownEmbodimentError:
            continue
        if consistency.has_kinematics(robot):
            yield robot
