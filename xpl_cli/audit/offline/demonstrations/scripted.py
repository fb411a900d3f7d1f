"""Small demonstrations by a scripted expert, for fixtures of rules and for tests: a colour is the goal.

The red of the picture is where joint 1 goes, its blue where joint 2 goes; the gripper closes half-way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl.trajectory import Writer
from xpl_cli.audit.offline.demonstrations import declaration

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from xpl.contract import ObservationDict


STEPS: Final = 16
SIZE: Final = (12, 16)
SHARE: Final = 0.2
"""Part of the way to the goal that each command goes."""


def write(package: Path, robot: str, episodes: int, seed: int = 0) -> Path:
    """Write episodes and `demonstrations.yml` into a package, and return the folder of the episodes.

    Args:
        package: its folder.
        robot: name of an embodiment with one arm.
        episodes: how many.
        seed: of where they begin and go.
    """
    folder, rng = package / "demonstrations", np.random.default_rng(seed)
    for number in range(episodes):
        path = folder / f"episode_{number:07d}.hdf5"
        metadata = {"robot": robot, sdk.Deploy.ACTION_TYPE: sdk.ACTION_TYPES[0]}
        with Writer(path, images="png", frequency=25.0, episode=metadata) as episode:
            for obs, action in _episode(robot, rng):
                episode.add(obs, action)
    digests = {path.name: declaration.digest(path) for path in sorted(folder.glob("*.hdf5"))}
    (package / declaration.FILE).write_text(declaration.render(folder.name, digests), encoding="utf-8")
    return folder


def _episode(robot: str, rng: np.random.Generator) -> Iterator[tuple[ObservationDict, dict[str, np.ndarray]]]:
    (arm,) = get_embodiment(robot).arms
    joints, goal = rng.uniform(-0.5, 0.5, arm.dof), rng.uniform(-0.5, 0.5, arm.dof)
    colour = rng.uniform(0.1, 0.9, 3)
    goal[:2] = colour[0] - 0.5, colour[2] - 0.5
    goal[2:] = joints[2:] + 0.1
    picture = np.broadcast_to(np.rint(255 * colour).astype(np.uint8), (*SIZE, 3))
    opening = 1.0
    for step in range(STEPS):
        obs = {
            sdk.Obs.VISION: {sdk.CAMERAS[1][0]: {sdk.Camera.COLOR: np.ascontiguousarray(picture)}},
            sdk.Obs.STATE: {
                sdk.State.ARM_JOINT_STATE: joints.astype(np.float32),
                sdk.State.EE_JOINT_STATE: np.array([opening], np.float32),
            },
            sdk.Obs.INSTRUCTION: "go where the colour says",
        }
        joints = joints + SHARE * (goal - joints)
        opening = 1.0 if 2 * step < STEPS else 0.0
        yield (
            obs,
            {
                sdk.State.ARM_JOINT_STATE: joints.astype(np.float32),
                sdk.State.EE_JOINT_STATE: np.array([opening], np.float32),
            },
        )
