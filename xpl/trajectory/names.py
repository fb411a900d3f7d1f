"""Names of the parts of observation and action in a file.

A part is a path, `("state", "left_arm_joint_state")`; in the file it is `("state", "left_arm_joint_states")`. All names
are the standard's (`xpl._spec`, from spec/); a name that it does not define is the same in both.
"""

from __future__ import annotations

from xpl import _spec as spec

DatasetPath = tuple[str, ...]

EPISODE, STEPS = "episode", "steps"
"""Groups below `additional_info` for metadata of the episode (JSON) and of its steps."""

GROUND_TRUTH: DatasetPath = (spec.Trajectory.ADDITIONAL_INFO, STEPS, spec.Obs.PRIVILEGED)
"""Path of the simulator's ground truth, if it was recorded."""

_PREFIXES = tuple(prefix for prefix in spec.ARM_PREFIXES[2] if prefix)
_SERIES = (spec.Trajectory.STATE, spec.Trajectory.ACTION)
_STATE = {stored: name for name, stored in spec.TRAJECTORY_STATE.items()}
_CAMERA = {
    **{other: name for name, others in spec.READ_ALIASES.items() if name in spec.TRAJECTORY_CAMERA for other in others},
    **{stored: name for name, stored in spec.TRAJECTORY_CAMERA.items()},
}


def stored_path(part: DatasetPath) -> DatasetPath:
    """Return the path in a file of a part of an observation, or of an action below `action`."""
    if part[0] in _SERIES:
        return (part[0], *(_renamed(name, spec.TRAJECTORY_STATE) for name in part[1:]))
    if part[0] == spec.Trajectory.VISION and len(part) == 3:
        name = _CAMERA.get(part[2], part[2])
        return (*part[:2], spec.TRAJECTORY_CAMERA.get(name, name))
    if part[0] == spec.Obs.PRIVILEGED:
        return (*GROUND_TRUTH, *part[1:])
    return part


def observation_path(path: DatasetPath) -> DatasetPath:
    """Return the part of an observation or action of a path in a file; the inverse of `stored_path`."""
    if path[0] in _SERIES:
        return (path[0], *(_renamed(name, _STATE) for name in path[1:]))
    if path[0] == spec.Trajectory.VISION and len(path) == 3:
        return (*path[:2], _CAMERA.get(path[2], path[2]))
    if is_ground_truth(path):
        return path[len(GROUND_TRUTH) - 1 :]
    return path


def is_ground_truth(path: DatasetPath) -> bool:
    """Return whether a dataset is part of the ground truth."""
    return path[: len(GROUND_TRUTH)] == GROUND_TRUTH and len(path) > len(GROUND_TRUTH)


def is_series(path: DatasetPath) -> bool:
    """Return whether a dataset has one row per step by its name: below `state` and `action`."""
    return path[0] in _SERIES


def is_image(path: DatasetPath, *leaves: str) -> bool:
    """Return whether a dataset belongs to a camera and has one of these names of an observation."""
    return len(path) == 3 and path[0] == spec.Trajectory.VISION and observation_path(path)[2] in leaves


def _renamed(name: str, table: dict[str, str]) -> str:
    prefix = next((prefix for prefix in _PREFIXES if name.startswith(prefix)), "")
    return prefix + table.get(name[len(prefix) :], name[len(prefix) :])
