"""Runs in the Python of envs/libero: moves the arms, observes, replays in LIBERO's own wrapper; prints JSON."""

from __future__ import annotations

import os
from typing import Any

import looking
import numpy as np
from looking import make

os.environ.setdefault("NUMBA_DISABLE_JIT", "1")  # compiling takes longer than what is looked at
TASK = "libero_spatial_0"
KNOWN = {"embodiment": "panda_libero", "task": TASK}
STEPS = 25


def _moved() -> dict[str, Any]:
    """Where the tool goes and turns, what the fingers do, what joints and poses say; and LIBERO plays it again."""
    env = make("libero", **KNOWN)
    results: dict[str, Any] = {"replayed": _replayed(env), "axes": looking.along_axes(env, 0.05, steps=STEPS)}
    results["openings"], results["turns"] = looking.openings(env, steps=STEPS), looking.turns(env, steps=STEPS)
    results["range"] = env._envs[0]._episode._env.robots[0].controller.output_max.tolist()
    results |= {**_told(env), "guessed": looking.guessed(env, episodes=3, max_steps=100)}
    env.close()
    return results


def _told(env: Any) -> dict[str, Any]:
    """What joints and poses say now, here and in LIBERO's own words, and where the arm stands."""
    results: dict[str, Any] = {}
    episode = env._envs[0]._episode
    obs = env.get_obs()
    base = episode._env.sim.data
    body = episode._env.sim.model.body_name2id("robot0_base")
    results["base"] = [base.body_xpos[body].tolist(), base.body_xquat[body].tolist()]
    results["state"] = looking.listed(obs["state"])
    results["theirs"] = looking.listed({name: obs["privileged"][f"robot0_eef_{name}"] for name in ("pos", "quat")})
    return results


def _glimpsed(steps: int = 8) -> dict[str, Any]:
    """What one scene shows that is loaded once: the arm is sent along +x and its fingers close; then one picture."""
    env = make("libero", **KNOWN)
    results: dict[str, Any] = {
        "travelled": looking.travelled(env, (0.05, 0, 0), opening=0.0, steps=steps),
        **_told(env),
    }
    episode = env._envs[0]._episode
    results["states"] = len(episode._states)
    results["result"] = env.results()[0]
    try:
        results["seen"] = _shown(env, episode._renderer.seen(episode._env.env, episode._obs)["cam_head"])
    except Exception as error:
        if type(error).__name__ != "RendererMissingError":
            raise
        results["not_drawn"] = str(error)
    env.close()
    return results


def _replayed(env: Any) -> dict[str, int]:
    """Play random actions here, and what LIBERO was told in its own wrapper; count steps whose state differs at all."""
    from libero.libero.envs.env_wrapper import ControlEnv

    commands, states = looking.played(env, lambda env: env._envs[0]._episode._env.get_sim_state(), STEPS)
    episode = env._envs[0]._episode
    theirs = ControlEnv(
        bddl_file_name=episode._env.env.bddl_file_name, has_offscreen_renderer=False, use_camera_obs=False
    )
    theirs.seed(0)
    theirs.reset()
    theirs.set_init_state(episode._states[3])
    for _ in range(10):
        theirs.step([0, 0, 0, 0, 0, 0, -1])
    again = [theirs.get_sim_state()]
    for command in commands:
        theirs.step(command)
        again.append(theirs.get_sim_state())
    theirs.close()
    return {"steps": len(states), "different": looking.different(states, again)}


def _seen() -> dict[str, Any]:
    """What a picture shows that LIBERO drew for a policy."""
    env = make("libero", **KNOWN, cameras=[128, 128])
    env.reset([0])
    results = _shown(env, env.get_obs()["vision"]["cam_head"])
    results["observed"] = bool(
        (env.get_obs()["vision"]["cam_head"]["color"] == env.simulated().observation["agentview_image"][::-1]).all()
    )
    env.close()
    return results


def _shown(env: Any, head: dict[str, Any]) -> dict[str, Any]:
    """Whether a known point lies in the picture where its projection says, by what MuJoCo says each pixel shows."""
    sim, truth = env._envs[0]._episode._env.sim, env.get_obs()["privileged"]
    height, width = head["color"].shape[:2]
    drawn = {"camera_name": "agentview", "height": height, "width": width}
    bodies = sim.render(**drawn, segmentation=True)[::-1]
    apart = head["color"].astype(np.int16) - sim.render(**drawn)[::-1]  # the second drawing of a scene rounds otherwise
    results: dict[str, Any] = {"raw": bool(np.abs(apart).max() <= 1)}
    for name in ("plate_1", "cookies_1", "akita_black_bowl_1"):
        column, row = (round(value - 0.5) for value in looking.projected(head, truth[f"{name}_pos"]))
        body = sim.model.geom_bodyid[bodies[row, column, 1]]
        upside_down = sim.model.geom_bodyid[bodies[height - 1 - row, column, 1]]
        results[name] = [sim.model.body_id2name(each).startswith(name) for each in (body, upside_down)]
    return results


def _deltas() -> list[list[float]]:
    env = make("libero", **KNOWN, setting="delta")
    results = looking.changes(env, (0.025, -0.025, 0.0125))
    env.close()
    return results


if __name__ == "__main__":
    looking.show({"glimpse": _glimpsed, "moved": _moved, "deltas": _deltas, "seen": _seen})
