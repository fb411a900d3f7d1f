"""Differently written sets: those that thresholds were chosen on, and those that were made when the probe was done."""

from __future__ import annotations

import math

from tests.support.recordings.demonstrations import Convention

DEGREE = math.pi / 180
POSE = ("position", "rotation", "gripper")
ONE = tuple((task, "franka_single", seed) for task in ("lift_cube", "push_block") for seed in (0, 1))
TWO = tuple((task, "arx_x5", seed) for task in ("place_dual", "handover_block") for seed in (0, 1))
"""Motions: task, robot, seed."""

TUNED: dict[str, tuple[tuple[tuple[str, str, int], ...], Convention]] = {
    "joints": (ONE, Convention(stamps=("timestamp", 1.0))),
    "two arms": (TWO, Convention(named=True)),
    "degrees, delta to state": (ONE, Convention(unit=DEGREE, reference="delta_state", gripper=(0, 0.08))),
    "two arms, delta to command, reversed grippers": (
        TWO,
        Convention(named=True, reference="delta_command", gripper=(1, 0), action_gripper=(1, -1)),
    ),
    "pose xyzw beside joints": (ONE, Convention(state=POSE, action=POSE, form="quaternion_xyzw", beside=True)),
    "tcp in the base, wxyz": (ONE, Convention(state=POSE, action=POSE, beside=True, frame="base", point="tcp")),
    "axis-angle, fingers, delta to state": (
        ONE,
        Convention(
            state=("position", "rotation", "fingers"),
            action=POSE,
            form="axis_angle",
            reference="delta_state",
            action_gripper=(1, -1),
            beside=True,
        ),
    ),
    "two arms, rpy": (TWO, Convention(state=POSE, action=POSE, form="euler", euler="xyz", beside=True)),
    "6D rows": (ONE, Convention(state=POSE, action=POSE, form="rot6d_rows", beside=True)),
    "two arms, min-max": (TWO, Convention(named=True, normalise="min_max")),
    "delta to state, mean-std": (ONE, Convention(normalise="mean_std", reference="delta_state")),
    "permuted commands": (ONE, Convention(action_order=(3, 1, 0, 2, 6, 5, 4))),
    "permuted joints": (
        ONE,
        Convention(state=POSE, action=("joints", "gripper"), order=(6, 5, 4, 3, 2, 1, 0), beside=True),
    ),
    "every second step, late": (TWO, Convention(every=2, late=3, stamps=("time", 1000.0))),
    "axis-angle, body deltas, no joints": (
        ONE,
        Convention(state=POSE, action=POSE, form="axis_angle", reference="delta_state", applied="body"),
    ),
    "Euler degrees, mm": (
        ONE,
        Convention(state=POSE, action=POSE, form="euler", euler="XYZ", degrees=True, length=0.001, beside=True),
    ),
}
"""Sets that thresholds were chosen on."""

STACK = tuple(
    (task, "franka_single", seed)
    for task, seed in (("stack_blocks_two", 3), ("pick_by_language", 4), ("stack_blocks_two", 5))
)
PAIR = tuple(
    (task, "piper", seed) for task, seed in (("lift_tray_bimanual", 2), ("stack_blocks_two", 3), ("place_dual", 6))
)

NEW: dict[str, tuple[tuple[tuple[str, str, int], ...], Convention]] = {
    "6D columns, delta to command": (
        STACK,
        Convention(state=POSE, action=POSE, form="rot6d_columns", reference="delta_command", beside=True),
    ),
    "matrix in cm, separate columns": (
        STACK,
        Convention(
            state=POSE, action=POSE, form="matrix", length=0.01, separate=True, beside=True, action_gripper=(0.08, 0)
        ),
    ),
    "zyx degrees in the base": (
        STACK,
        Convention(
            state=POSE, action=POSE, form="euler", euler="zyx", degrees=True, frame="base", beside=True, gripper=(1, 0)
        ),
    ),
    "two arms in degrees, other order": (
        PAIR,
        Convention(unit=DEGREE, action_order=(5, 4, 3, 2, 1, 0), named=True, stamps=("timestamp", 1e9)),
    ),
}
"""Sets with conventions and motions that no threshold was chosen on. The first run showed wrong claims about deltas to
the state that were normalised, which were repaired."""

THIRD = tuple(("drawer_place", "arx_x5_single", seed) for seed in (1, 2, 3))
FOURTH = tuple(("stack_blocks_two", "aloha_agilex", seed) for seed in (8, 9, 10))

LAST: dict[str, tuple[tuple[tuple[str, str, int], ...], Convention]] = {
    "one arm, delta to state, min-max": (THIRD, Convention(named=True, reference="delta_state", normalise="min_max")),
    "one arm, delta to command, min-max": (
        THIRD,
        Convention(named=True, reference="delta_command", normalise="min_max"),
    ),
    "one arm, 6D rows, delta to state": (
        THIRD,
        Convention(state=POSE, action=POSE, form="rot6d_rows", reference="delta_state", beside=True, gripper=(0.04, 0)),
    ),
    "two arms, delta to state, mean-std": (
        FOURTH,
        Convention(named=True, reference="delta_state", normalise="mean_std"),
    ),
    "two arms, axis-angle in mm": (
        FOURTH,
        Convention(state=POSE, action=POSE, form="axis_angle", length=0.001, beside=True, frame="base"),
    ),
    "two arms, delta to command, wxyz": (
        FOURTH,
        Convention(state=POSE, action=POSE, reference="delta_command", separate=True, beside=True),
    ),
}
"""Made after that repair, and run once."""
