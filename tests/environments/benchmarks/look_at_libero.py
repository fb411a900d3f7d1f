"""Runs in the Python of envs/libero: moves the arm, looks, plays again in LIBERO's own wrapper; prints JSON."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from typing import Any

import looking
import numpy as np
from looking import make

from xpl import rotation

os.environ.setdefault("NUMBA_DISABLE_JIT", "1")  # compiling takes longer than what is looked at
TASK = "libero_spatial_0"
KNOWN = {"embodiment": sys.argv[1], "task": TASK}
STEPS = 25


def _still(env: Any) -> dict[str, Any]:
    """What is seen without pictures: where the tool goes and turns, what the fingers do, what joints and poses say."""
    found: dict[str, Any] = {"axes": looking.along_axes(env, 0.05, steps=STEPS)}
    found["openings"] = looking.openings(env, steps=STEPS)
    found["turns"] = [_turned(env, axis) for axis in np.eye(3)]
    episode = env._places[0]._episode
    found["range"] = episode._env.robots[0].controller.output_max.tolist()
    return {**found, **_told(env)}


def _told(env: Any) -> dict[str, Any]:
    """What joints and poses say now, here and in LIBERO's own words, and where the arm stands."""
    found: dict[str, Any] = {}
    episode = env._places[0]._episode
    obs = env.get_obs()
    base = episode._env.sim.data
    body = episode._env.sim.model.body_name2id("robot0_base")
    found["base"] = [base.body_xpos[body].tolist(), base.body_xquat[body].tolist()]
    found["state"] = {name: value.tolist() for name, value in obs["state"].items()}
    found["theirs"] = {
        name: np.asarray(obs["privileged"][name]).tolist() for name in ("robot0_eef_pos", "robot0_eef_quat")
    }
    return found


def _glimpsed(steps: int = 8) -> dict[str, Any]:
    """What one scene shows that is loaded once: the arm is sent along +x and its fingers close; then one picture."""
    env = make("libero", **KNOWN)
    found: dict[str, Any] = {"travelled": looking.travelled(env, (0.05, 0, 0), opening=0.0, steps=steps), **_told(env)}
    episode = env._places[0]._episode
    found["states"] = len(episode._states)
    found["result"] = env.results()[0]
    try:
        found["seen"] = _shown(env, episode._pictures.seen(episode._env.env, episode._obs)["cam_head"])
    except Exception as error:
        if type(error).__name__ != "RendererMissingError":
            raise
        found["not_drawn"] = str(error)
    env.close()
    return found


def _turned(env: Any, axis: np.ndarray) -> list[float]:
    """Return the rotation vector in the world by which the tool turned when it was told to turn by 0.3 rad."""
    env.reset([0])
    first = env.get_obs()
    action = looking.command(first)
    before = first["state"]["tcp_pose"][3:]
    action["ee_pose"][3:] = rotation.multiply(rotation.from_axis_angle(0.3 * axis), action["ee_pose"][3:])
    for _ in range(STEPS):
        env.take_action(action)
    after = env.get_obs()["state"]["tcp_pose"][3:]
    return rotation.to_axis_angle(rotation.multiply(after, rotation.conjugate(before))).tolist()


def _replayed(env: Any, seed: int = 3) -> dict[str, Any]:
    """Play random actions here, and what LIBERO was told in its own wrapper; count steps whose state differs at all."""
    from libero.libero.envs.env_wrapper import ControlEnv, OffScreenRenderEnv

    bare = {"has_offscreen_renderer": False, "use_camera_obs": False}
    wrapper, options = (OffScreenRenderEnv, {}) if "pictures" in sys.argv else (ControlEnv, bare)
    rng = np.random.default_rng(0)
    env.reset([seed])
    episode = env._places[0]._episode
    commands, states = [], [episode._env.get_sim_state()]
    for _ in range(STEPS):
        action = looking.command(env.get_obs(), rng.uniform(-0.05, 0.05, 3), opening=float(rng.uniform()))
        env.take_action(action)
        commands.append(looking.told(env))
        states.append(episode._env.get_sim_state())
    theirs = wrapper(bddl_file_name=episode._env.env.bddl_file_name, **options)
    theirs.seed(0)
    theirs.reset()
    theirs.set_init_state(episode._states[seed])
    for _ in range(10):
        theirs.step([0, 0, 0, 0, 0, 0, -1])
    again = [theirs.get_sim_state()]
    for command in commands:
        theirs.step(command)
        again.append(theirs.get_sim_state())
    theirs.close()
    return {"steps": len(states), "different": sum(bool((a != b).any()) for a, b in zip(states, again, strict=True))}


def _guessed(env: Any) -> int:
    """Return how many of three episodes of random actions succeed."""
    rng, solved = np.random.default_rng(1), 0
    for seed in range(3):
        env.reset([seed], {"max_steps": 100})
        while not env.is_episode_end():
            env.take_action(looking.command(env.get_obs(), rng.uniform(-0.05, 0.05, 3), float(rng.uniform())))
        solved += env.results()[0]["success"]
    return solved


def _seen() -> dict[str, Any]:
    """What a picture shows that LIBERO drew for a policy."""
    env = make("libero", **KNOWN, cameras=[128, 128])
    env.reset([0])
    found = _shown(env, env.get_obs()["vision"]["cam_head"])
    found["observed"] = bool(
        (env.get_obs()["vision"]["cam_head"]["color"] == env.simulated().observation["agentview_image"][::-1]).all()
    )
    env.close()
    return found


def _shown(env: Any, head: dict[str, Any]) -> dict[str, Any]:
    """Whether a known point lies in the picture where its projection says, by what MuJoCo says each pixel shows."""
    sim, truth = env._places[0]._episode._env.sim, env.get_obs()["privileged"]
    height, width = head["color"].shape[:2]
    drawn = {"camera_name": "agentview", "height": height, "width": width}
    shown = sim.render(**drawn, segmentation=True)[::-1]
    apart = head["color"].astype(np.int16) - sim.render(**drawn)[::-1]  # the second drawing of a scene rounds otherwise
    found: dict[str, Any] = {"raw": bool(np.abs(apart).max() <= 1)}
    for name in ("plate_1", "cookies_1", "akita_black_bowl_1"):
        column, row = (round(value - 0.5) for value in looking.projected(head, truth[f"{name}_pos"]))
        body = sim.model.geom_bodyid[shown[row, column, 1]]
        upside_down = sim.model.geom_bodyid[shown[height - 1 - row, column, 1]]
        found[name] = [sim.model.body_id2name(each).startswith(name) for each in (body, upside_down)]
    return found


def _deltas() -> list[list[float]]:
    env = make("libero", **KNOWN, setting="delta")
    found = [each.tolist() for each in looking.changes(env, (0.025, -0.025, 0.0125), opening=0.25)]
    env.close()
    return found


if __name__ == "__main__":
    with contextlib.redirect_stdout(io.StringIO()):
        if "glimpse" in sys.argv:
            answer = _glimpsed()
        else:
            env = make("libero", **KNOWN)
            answer = {"replayed": _replayed(env)}
            if "moved" in sys.argv:
                answer.update(_still(env), deltas=_deltas(), guessed=_guessed(env))
            env.close()
            if "pictures" in sys.argv:
                answer["seen"] = _seen()
    print(json.dumps(answer))  # noqa: T201
