"""Runs in the Python of envs/robosuite: moves arms, looks, plays again in robosuite itself; prints JSON."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from typing import Any

import looking
import numpy as np
from looking import make

from xpl import rotation

ONE, TWO = sys.argv[1:3]
STEPS, FAR = 15, 0.03
KNOWN = {"task": "Lift", "embodiment": ONE}


def _played(setting: str) -> dict[str, Any]:
    """Where the tool goes and turns for commands in one setting."""
    env = make("robosuite", **KNOWN, setting=setting)
    found: dict[str, Any] = {"axes": looking.along_axes(env, FAR, steps=STEPS)}
    found["turns"] = [_turned(env, axis) for axis in np.eye(3)]
    env.close()
    return found


def _turned(env: Any, axis: np.ndarray) -> list[float]:
    """Return the rotation vector in the world by which the tool turned when it was told to turn by 0.3 rad."""
    env.reset([0])
    first = env.get_obs()
    action, before = looking.command(first), first["state"]["tcp_pose"][3:]
    action["ee_pose"][3:] = rotation.multiply(rotation.from_axis_angle(0.3 * axis), action["ee_pose"][3:])
    for _ in range(3 * STEPS):  # a turn takes longer to settle than a move
        env.take_action(action)
    after = env.get_obs()["state"]["tcp_pose"][3:]
    return rotation.to_axis_angle(rotation.multiply(after, rotation.conjugate(before))).tolist()


def _still() -> dict[str, Any]:
    """What one arm says of itself."""
    env = make("robosuite", **KNOWN)
    found: dict[str, Any] = {"openings": looking.openings(env, steps=STEPS)}
    obs, episode = env.get_obs(), env._places[0]._episode
    sim = episode._env.sim
    body = sim.model.body_name2id("robot0_base")
    found["base"] = [sim.data.body_xpos[body].tolist(), sim.data.body_xquat[body].tolist()]
    found["state"] = {name: value.tolist() for name, value in obs["state"].items()}
    found["theirs"] = obs["privileged"]["robot0_eef_quat"].tolist()
    found["range"] = episode._env.robots[0].part_controllers["right"].output_max.tolist()
    found["replayed"] = _replayed(env)
    rng, solved = np.random.default_rng(1), 0
    for seed in range(2):
        env.reset([seed], {"max_steps": 40})
        while not env.is_episode_end():
            env.take_action(looking.command(env.get_obs(), rng.uniform(-0.05, 0.05, 3), float(rng.uniform())))
        solved += env.results()[0]["success"]
    env.close()
    return {**found, "guessed": solved}


def _replayed(env: Any) -> dict[str, int]:
    """Play random actions here, and what robosuite was told in an environment of its own; count states that differ."""
    import robosuite

    env.reset([3])
    episode, rng = env._places[0]._episode, np.random.default_rng(0)
    commands, states = [], [episode._env.sim.get_state().flatten()]
    for _ in range(STEPS):
        env.take_action(looking.command(env.get_obs(), rng.uniform(-0.05, 0.05, 3), opening=float(rng.uniform())))
        commands.append(looking.told(env))
        states.append(episode._env.sim.get_state().flatten())
    theirs = robosuite.make("Lift", robots="Panda", has_offscreen_renderer=False, use_camera_obs=False, seed=0)
    theirs.rng.bit_generator.state = np.random.default_rng(3).bit_generator.state
    theirs.reset()
    again = [theirs.sim.get_state().flatten()]
    for command in commands:
        theirs.step(command)
        again.append(theirs.sim.get_state().flatten())
    return {"steps": len(states), "different": sum(bool((a != b).any()) for a, b in zip(states, again, strict=True))}


def _two() -> dict[str, Any]:
    """Where both tools go while one arm is commanded, in a task with two arms, whose bases are turned."""
    env = make("robosuite", task="TwoArmLift", embodiment=TWO)
    found: dict[str, Any] = {}
    for arm in ("left", "right"):
        for place, way in enumerate("xyz"):
            env.reset([0])
            first = env.get_obs()["state"]
            action = {key: value.copy() for key, value in first.items() if key.endswith(("ee_pose", "ee_joint_state"))}
            action[f"{arm}_ee_pose"][place] += FAR
            for _ in range(STEPS):
                env.take_action(action)
            last = env.get_obs()["state"]
            moved = {side: last[f"{side}_tcp_pose"][:3] - first[f"{side}_tcp_pose"][:3] for side in ("left", "right")}
            found[f"{arm} {way}"] = {side: value.tolist() for side, value in moved.items()}
    found["sides"] = [float(last[f"{side}_ee_pose"][1]) for side in ("left", "right")]
    env.close()
    return found


def _deltas() -> list[list[float]]:
    env = make("robosuite", **KNOWN, setting="delta")
    found = [each.tolist() for each in looking.changes(env, (0.025, -0.025, 0.0125), opening=0.25)]
    env.close()
    return found


def _seen() -> dict[str, Any]:
    """Whether the cube lies in the picture where its projection says, by what MuJoCo says each pixel shows."""
    env = make("robosuite", **KNOWN, cameras=[128, 128])
    env.reset([0])
    obs = env.get_obs()
    sim, found = env._places[0]._episode._env.sim, {}
    cube = obs["privileged"]["cube_pos"]
    for name, source in (("cam_head", "agentview"), ("cam_wrist", "robot0_eye_in_hand")):
        shown = sim.render(camera_name=source, height=128, width=128, segmentation=True)[::-1]
        column, row = (round(value - 0.5) for value in looking.projected(obs["vision"][name], cube))
        geoms = [shown[row, column, 1], shown[127 - row, column, 1]]
        found[name] = [(sim.model.geom_id2name(int(geom)) or "").startswith("cube") for geom in geoms]
    env.close()
    return found


def _every(tasks: list[str]) -> dict[str, Any]:
    """Begin an episode of tasks twice, with another between, and play two steps."""
    found = {}
    for task in tasks:
        env = make("robosuite", task=task, embodiment=TWO if task.startswith("TwoArm") else ONE)
        states = []
        for seed in (5, 6, 5):
            env.reset([seed])
            states.append(env._places[0]._episode._env.sim.get_state().flatten())
        first = env.get_obs()["state"]
        keys = [key for key in first if key.endswith(("ee_pose", "ee_joint_state")) and "delta" not in key]
        for _ in range(2):
            env.take_action({key: first[key] for key in keys})
        again, other = bool((states[0] == states[2]).all()), bool((states[0] == states[1]).all())
        found[task] = [again, other, env.results()[0]["steps"]]
        env.close()
    return found


if __name__ == "__main__":
    what = sys.argv[3]
    with contextlib.redirect_stdout(io.StringIO()):
        if what == "moved":
            answer = {"clean": _played("clean"), "absolute": _played("absolute"), **_still()}
            answer.update(two=_two(), deltas=_deltas())
        elif what == "every":
            answer = _every(sys.argv[4:])
        else:
            answer = _seen()
    print(json.dumps(answer))  # noqa: T201
