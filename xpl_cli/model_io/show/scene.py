"""The scene of a report: test cards and a scripted state, or an environment's first observation, or photographs."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl import image_codec
from xpl.convert import ConversionError
from xpl.observation import ObservationError
from xpl_cli.basics import files
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.model_io import script
from xpl_cli.model_io.show.cards import card

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    import numpy as np

    from xpl import Embodiment
    from xpl.contract import Observation, ObservationDict
    from xpl.manifest import Manifest

_SIZE: Final = (480, 640)
_PHOTO_BYTES: Final = 64 * 2**20
_PLACE: Final = 1
"""Of the script: joints and rotations that are neither near their limits nor near a half turn."""


@dataclass(frozen=True)
class ReportScene:
    """An episode of one environment.

    Attributes:
        observations: of the standard, oldest first; the last is now.
        origin: where they are from, in words.
    """

    observations: Sequence[Observation]
    origin: str


def scripted(manifest: Manifest, robot: Embodiment, cameras: Sequence[str], reach: int) -> ReportScene:
    """Return test cards and a scripted state.

    Args:
        manifest: policy.yml, whose cameras may have sizes.
        robot: the robot.
        cameras: what the block reads besides.
        reach: observations back to which the model looks.

    Raises:
        UserError: if the policy needs what only a simulator has.
    """
    try:
        sizes = script.cameras(manifest, robot)
    except ConversionError as error:
        raise UserError(f"{error}; show it one with --environment", code=ExitCode.NOT_RUN) from None
    sizes = {**sizes, **{camera: _SIZE for camera in cameras if camera not in sizes}}
    stage = script.ScriptedScene(robot, sizes)
    observations = []
    for ago in reversed(range(reach)):
        observation = stage.observation(0, _PLACE + 4 * (reach - 1 - ago))
        when = "now" if ago == 0 else f"{ago} step{'s' if ago > 1 else ''} ago"
        cards = {name: card(name, number, *sizes[name], when) for number, name in enumerate(sizes)}
        observations.append(with_pictures(observation, cards))
    return ReportScene(observations, "test cards and a scripted state")


@dataclass(frozen=True)
class EnvironmentEpisode:
    """One in an environment.

    Attributes:
        environment: name of a package, or its folder.
        task: a task of it; None for the first that suits the robot.
        seed: of the episode.
    """

    environment: str
    task: str | None = None
    seed: int = 0


def of_environment(
    episode: EnvironmentEpisode, robot: Embodiment, action_type: str, cameras: Sequence[str]
) -> ReportScene:
    """Return the first observation of an episode in an environment.

    Args:
        episode: which.
        robot: the robot.
        action_type: joint or ee.
        cameras: that have to be there.

    Raises:
        UserError: if the environment does not offer the robot or the task, cannot draw, or lacks a camera.
    """
    from xpl_cli.environments import rollout
    from xpl_cli.packages import environments

    name = episode.environment
    environments.require_simulation(name)
    scenario = rollout.make_scenario(name, task=episode.task, embodiment=robot.name)
    try:
        environment = environments.make(
            name, {**scenario.config(), sdk.Deploy.ACTION_TYPE: action_type, "cameras": True}
        )
    except (ValueError, LookupError, RuntimeError) as error:
        raise UserError(f"{name}: {error}", code=ExitCode.NOT_RUN) from None
    with contextlib.closing(environment) as env:
        try:
            env.reset([episode.seed])
            observation = image_codec.decode_observation(env.get_obs())
        except (RuntimeError, ObservationError) as error:
            raise UserError(f"{name}: {error}", code=ExitCode.NOT_RUN) from None
    missing = [camera for camera in cameras if camera not in observation[sdk.Obs.VISION]]
    if missing:
        raise UserError(f"{name} has no {', '.join(missing)}; it has {', '.join(observation[sdk.Obs.VISION])}")
    return ReportScene([observation], f"the first observation of {name}, {scenario.task}, seed {episode.seed}")


def photographed(scene: ReportScene, photos: Mapping[str, Path]) -> ReportScene:
    """Return a scene in which cameras see pictures from files.

    Raises:
        UserError: if a file is no picture, or there is no such camera.
    """
    if not photos:
        return scene
    cameras = scene.observations[-1][sdk.Obs.VISION]
    unknown = [camera for camera in photos if camera not in cameras]
    if unknown:
        raise UserError(f"there is no camera {', '.join(unknown)}; there are {', '.join(cameras)}")
    pictures = dict(_photos(photos))
    observations = [with_pictures(one, pictures) for one in scene.observations]
    sources = ", ".join(f"{camera} from {path.name}" for camera, path in photos.items())
    return ReportScene(observations, f"{scene.origin}; {sources}")


def _photos(photos: Mapping[str, Path]) -> Iterator[tuple[str, np.ndarray]]:
    for camera, path in photos.items():
        try:
            yield camera, image_codec.decode(files.read_regular(path, _PHOTO_BYTES))
        except (OSError, ObservationError) as error:
            raise UserError(f"{path} is no picture: {error}", code=ExitCode.NOT_FOUND) from None


def with_pictures(observation: Observation, pictures: Mapping[str, np.ndarray]) -> ObservationDict:
    """Return an observation with other pictures of some cameras."""
    vision = dict(observation[sdk.Obs.VISION])
    for camera, picture in pictures.items():
        vision[camera] = {**vision.get(camera, {}), sdk.Camera.COLOR: picture}
    return {**observation, sdk.Obs.VISION: vision}
