"""Runs in the Python of envs/robosuite: moves arms, observes, replays in robosuite itself; prints JSON."""

from __future__ import annotations

from typing import Any

import looking
import numpy as np
from looking import make

from xpl.environment import read_manifest

ONE, TWO = "panda_robosuite", "panda_robosuite_dual"
STEPS, FAR = 15, 0.03
KNOWN = {"task": "Lift", "embodiment": ONE}


def _played(setting: str) -> dict[str, Any]:
    """Where the tool goes and turns for commands in one setting."""
    env = make("robosuite", **KNOWN, setting=setting)
    results: dict[str, Any] = {"axes": looking.along_axes(env, FAR, steps=STEPS)}
    results["turns"] = looking.turns(env, steps=3 * STEPS)  # a turn takes longer to settle than a move
    env.close()
    return results


def _still() -> dict[str, Any]:
    """What one arm says of itself."""
    env = make("robosuite", **KNOWN)
    results: dict[str, Any] = {"openings": looking.openings(env, steps=STEPS)}
    obs, episode = env.get_obs(), env._envs[0]._episode
    sim = episode._env.sim
    body = sim.model.body_name2id("robot0_base")
    results["base"] = [sim.data.body_xpos[body].tolist(), sim.data.body_xquat[body].tolist()]
    results["state"] = looking.listed(obs["state"])
    results["theirs"] = obs["privileged"]["robot0_eef_quat"].tolist()
    results["range"] = episode._env.robots[0].part_controllers["right"].output_max.tolist()
    results |= {"replayed": _replayed(env), "guessed": looking.guessed(env, episodes=2, max_steps=40)}
    env.close()
    return results


def _state(env: Any) -> np.ndarray:
    """Return positions, speeds and time."""
    state: np.ndarray = env._envs[0]._episode._env.sim.get_state().flatten()
    return state


def _replayed(env: Any) -> dict[str, int]:
    """Play random actions here, and what robosuite was told in an environment of its own; count states that differ."""
    import robosuite

    commands, states = looking.played(env, _state, STEPS)
    theirs = robosuite.make("Lift", robots="Panda", has_offscreen_renderer=False, use_camera_obs=False, seed=0)
    theirs.rng.bit_generator.state = np.random.default_rng(3).bit_generator.state
    theirs.reset()
    again = [theirs.sim.get_state().flatten()]
    for command in commands:
        theirs.step(command)
        again.append(theirs.sim.get_state().flatten())
    return {"steps": len(states), "different": looking.different(states, again)}


def _two() -> dict[str, Any]:
    """Where both tools go while one arm is commanded, in a task with two arms, whose bases are turned."""
    env = make("robosuite", task="TwoArmLift", embodiment=TWO)
    results: dict[str, Any] = {}
    for arm in ("left", "right"):
        for index, way in enumerate("xyz"):
            env.reset([0])
            first = env.get_obs()["state"]
            action = {key: value.copy() for key, value in first.items() if key.endswith(("ee_pose", "ee_joint_state"))}
            action[f"{arm}_ee_pose"][index] += FAR
            for _ in range(STEPS):
                env.take_action(action)
            last = env.get_obs()["state"]
            moved = {side: last[f"{side}_tcp_pose"][:3] - first[f"{side}_tcp_pose"][:3] for side in ("left", "right")}
            results[f"{arm} {way}"] = {side: value.tolist() for side, value in moved.items()}
    results["sides"] = [float(last[f"{side}_ee_pose"][1]) for side in ("left", "right")]
    env.close()
    return results


def _deltas() -> list[list[float]]:
    env = make("robosuite", **KNOWN, setting="delta")
    results = looking.changes(env, (0.025, -0.025, 0.0125))
    env.close()
    return results


def _seen() -> dict[str, Any]:
    """Whether the cube lies in the picture where its projection says, by what MuJoCo says each pixel shows."""
    env = make("robosuite", **KNOWN, cameras=[128, 128])
    env.reset([0])
    obs = env.get_obs()
    sim, results = env._envs[0]._episode._env.sim, {}
    cube = obs["privileged"]["cube_pos"]
    for name, source in (("cam_head", "agentview"), ("cam_wrist", "robot0_eye_in_hand")):
        bodies = sim.render(camera_name=source, height=128, width=128, segmentation=True)[::-1]
        column, row = (round(value - 0.5) for value in looking.projected(obs["vision"][name], cube))
        geoms = [bodies[row, column, 1], bodies[127 - row, column, 1]]
        results[name] = [(sim.model.geom_id2name(int(geom)) or "").startswith("cube") for geom in geoms]
    env.close()
    return results


def _every() -> dict[str, Any]:
    """Begin an episode of each task twice, with another between, and play two steps."""
    results = {}
    for task in read_manifest(looking.ROOT / "envs" / "robosuite").tasks:
        env = make("robosuite", task=task, embodiment=TWO if task.startswith("TwoArm") else ONE)
        states = []
        for seed in (5, 6, 5):
            env.reset([seed])
            states.append(_state(env))
        first = env.get_obs()["state"]
        keys = [key for key in first if key.endswith(("ee_pose", "ee_joint_state")) and "delta" not in key]
        for _ in range(2):
            env.take_action({key: first[key] for key in keys})
        again, other = bool((states[0] == states[2]).all()), bool((states[0] == states[1]).all())
        results[task] = [again, other, env.results()[0]["steps"]]
        env.close()
    return results


PARTS = {
    "clean": lambda: _played("clean"),
    "absolute": lambda: _played("absolute"),
    "still": _still,
    "two": _two,
    "deltas": _deltas,
    "every": _every,
    "seen": _seen,
}

if __name__ == "__main__":
    looking.show(PARTS)
