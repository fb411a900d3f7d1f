"""Recorded runs that nobody played: lines of `xpl.record/1` (spec/v1/record.schema.json) drawn from a seed."""

from __future__ import annotations

import datetime as dt
import hashlib
import io
import json
import math
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from xpl_cli.evaluation.records.model import EpisodeRecord, PlannedCell, RunPlan, name_of

BEGAN = dt.datetime(2026, 11, 21, 9, 0, tzinfo=dt.UTC)
DIMENSIONS = ("precision", "long-horizon", "memory")
FREQUENCY = 25.0
CHUNK = 16
_BINS = 32
_STAGES = ("grasped", "lifted", "held")
_FACTS = {"processor": "x86_64, 2 cores", "system": "Linux 6.1", "python": "3.11.9", "xpl": "0.8.0", "mujoco": "4.0.0"}


@dataclass(frozen=True)
class Faults:
    """Shares of episodes that end otherwise than by what the policy can do."""

    policy: float = 0.02
    infrastructure: float = 0.0
    retried: float = 0.01


def synthetic_run(  # noqa: PLR0917 - what most tests vary
    folder: Path,
    tasks: Sequence[str] = ("lift_cube", "stack_cubes"),
    settings: Sequence[str] = ("clean", "randomized"),
    episodes: int = 20,
    seed: int = 0,
    rate: float | Mapping[tuple[str, str], float] = 0.6,
    *,
    policy: str = "Foo",
    faults: Faults | None = None,
    traces: int = 0,
    films: int = 0,
    played: int | None = None,
    spec: str = "v1",
    first_seed: int = 0,
) -> Path:
    """Write `records.jsonl` of a run into a folder and return the folder.

    Args:
        folder: is made.
        tasks: with `settings`: each pair is a cell of the plan.
        settings: see `tasks`.
        episodes: seeds of a cell.
        seed: of everything that is drawn here.
        rate: share of successes: of all cells, or by (task, setting).
        policy: name of the adapter.
        faults: how often something else goes wrong.
        traces: how many episodes, from the first on, have curves beside the records.
        films: how many have a film.
        played: episodes that were played so far; all by default.
        spec: version of the standard that the environment declares.
        first_seed: of every cell.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cells = [
        {
            "task": task,
            "setting": setting,
            "dimension": DIMENSIONS[number % len(DIMENSIONS)],
            "seeds": list(range(first_seed, first_seed + episodes)),
            "frozen": False,
        }
        for number, task in enumerate(tasks)
        for setting in settings
    ]
    first = _plan(policy, spec, cells)
    machine = {"kind": "machine", "machine": _digest(_FACTS), "facts": _FACTS}
    draw = random.Random(f"{seed} {policy}")  # noqa: S311 - made-up results, not secrets
    wanted = [(cell, own) for cell in cells for own in cell["seeds"]]
    lines = [first, machine]
    clock = BEGAN
    for index, (cell, own) in enumerate(wanted[:played]):
        chance = rate if isinstance(rate, (int, float)) else rate[cell["task"], cell["setting"]]
        for line in _attempts(draw, (index, cell, own), chance, faults or Faults()):
            clock += dt.timedelta(seconds=line["wall_seconds"])
            line.update(started=_time(clock), machine=machine["machine"])
            lines.append(line)
        if index < traces:
            lines[-1]["trace"] = _beside(folder, f"traces/{index}.npz", _trace(draw, lines[-1]["steps"]))
        if index < films:
            lines[-1]["film"] = _beside(folder, f"films/{index}.webp", _film(index))
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    (folder / "records.jsonl").write_text(text, encoding="utf-8")
    return folder


def renamed(first: Mapping[str, Any]) -> dict[str, Any]:
    """Return the first line of a record, whose plan somebody has changed, with the name that goes with it."""
    return {**first, "run": name_of(first)}


def rewritten(folder: Path, change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]] = list, **plan: Any) -> Path:
    """Change a record, and return its folder.

    Args:
        folder: of the run.
        change: returns what takes the place of the lines of its episodes.
        plan: new values of its plan, which gets the name that goes with them.
    """
    file = folder / "records.jsonl"
    first, machine, *episodes = (json.loads(line) for line in file.read_text(encoding="utf-8").splitlines())
    lines = [renamed({**first, **plan}), machine, *change(episodes)]
    file.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    return folder


def planned(config: Mapping[str, Any] | None = None, cells: Sequence[PlannedCell] = ()) -> RunPlan:
    """Return a plan of some cells, for a policy that is configured so."""
    told = RunPlan.parse(_plan("Foo", "v1", []))
    return replace(told, policy=replace(told.policy, config=config or {}), cells=cells)


def episode(**told: Any) -> EpisodeRecord:
    """Return a final line of an episode that succeeded, but for what is told."""
    place = {"index": 0, "attempt": 1, "final": True, "task": "lift_cube", "setting": "clean", "seed": 1}
    robot = {"embodiment": "arx_x5", "action_type": "joint", "machine": _digest(_FACTS), "containment": "apart"}
    ending = {"success": True, "score": 1.0, "end_reason": "success"}
    return EpisodeRecord(**{**place, **robot, **ending, "started": _time(BEGAN), "wall_seconds": 1.0, **told})


def _plan(policy: str, spec: str, cells: list[dict[str, Any]]) -> dict[str, Any]:
    told: dict[str, Any] = {
        "kind": "run",
        "schema": "xpl.record/1",
        "policy": {
            "name": policy,
            "spec": "v1",
            "digest": _digest(policy),
            "config": {"policy_name": policy, "env_cfg_type": "arx_x5", "action_type": "joint", "seed": 0},
            "checkpoint": {"path": "checkpoints/latest", "digest": _digest(f"{policy} weights")},
        },
        "environment": {"name": "mujoco", "spec": spec, "digest": _digest("mujoco")},
        "embodiment": "arx_x5",
        "action_type": "joint",
        "control": {"horizon": 8, "attempts": 3},
        "cells": cells,
        "until_width": None,
    }
    return {**told, "run": _digest(told), "created": _time(BEGAN)}


def _attempts(
    draw: random.Random, place: tuple[int, Mapping[str, Any], int], chance: float, faults: Faults
) -> Iterator[dict[str, Any]]:
    """Yield the attempts of an episode; the last is final."""
    index, cell, seed = place
    attempt = 1
    if draw.random() < faults.retried:
        yield _errored(draw, _place(*place, attempt, final=False))
        attempt = 2
    if draw.random() < faults.infrastructure:
        yield _errored(draw, _place(*place, attempt, final=True))
        return
    failed = draw.random() < faults.policy
    success = not failed and draw.random() < chance / max(1e-9, 1 - faults.policy)
    reached = len(_STAGES) if success else draw.randrange(len(_STAGES))
    steps = draw.randint(60, 180) if success else (draw.randint(5, 150) if failed else 200)
    count = math.ceil(steps / CHUNK)
    took = [draw.lognormvariate(-3.0, 0.4) for _ in range(count)]
    yield {
        **_place(*place, attempt, final=True),
        "instruction": f"Do {cell['task'].replace('_', ' ')}.",
        "layout": _layout(cell["task"], seed),
        "success": success,
        "score": round(reached / len(_STAGES), 4),
        "stages": {name: place < reached for place, name in enumerate(_STAGES)},
        "steps": steps,
        "failure": None if success else "policy" if failed else "task",
        "end_reason": "success" if success else "policy_error" if failed else "max_steps",
        **({"error": "left_arm_joint_state holds a value that is no number"} if failed else {}),
        "corrections": {"joint_velocity": draw.randint(1, 9)} if draw.random() < 0.2 else {},
        "wall_seconds": round(steps / FREQUENCY + sum(took), 3),
        "inference": {"count": count, "seconds": round(sum(took), 4), "histogram": _histogram(took)},
        "digest": _digest([index, seed, success]),
        "server": "server-1",
        "worker": f"{_FACTS['system']}:{index % 2}",
        "containment": "apart",
    }


def _errored(draw: random.Random, place: dict[str, Any]) -> dict[str, Any]:
    return {
        **place,
        "success": None,
        "score": None,
        "failure": "infrastructure",
        "end_reason": "infrastructure",
        "error": "the policy server ended (signal 9)",
        "steps": draw.randint(0, 100),
        "wall_seconds": round(draw.uniform(0.5, 4.0), 3),
    }


def _place(index: int, cell: Mapping[str, Any], seed: int, attempt: int, *, final: bool) -> dict[str, Any]:
    return {
        "kind": "episode",
        "index": index,
        "attempt": attempt,
        "final": final,
        "task": cell["task"],
        "setting": cell["setting"],
        "seed": seed,
        "embodiment": "arx_x5",
        "action_type": "joint",
    }


def _layout(task: str, seed: int) -> dict[str, Any]:
    """Return where things stood: the same for every policy."""
    draw = random.Random(f"{task} {seed}")  # noqa: S311 - see above
    return {"cube": [round(draw.uniform(-0.2, 0.2), 3), round(draw.uniform(-0.1, 0.1), 3)]}


def _histogram(seconds: Sequence[float]) -> list[int]:
    counts = [0] * _BINS
    for value in seconds:
        counts[min(_BINS - 1, max(0, math.floor(2 * math.log2(value * 1000))))] += 1
    return counts


def _trace(draw: random.Random, steps: int) -> bytes:
    """Return an .npz of curves as the runner writes it."""
    generator = np.random.default_rng(draw.randrange(1 << 30))
    time = np.arange(steps)[:, None] / FREQUENCY
    curves: dict[str, Any] = {
        "frequency": np.float64(FREQUENCY),
        "chunk_starts": np.arange(0, steps, CHUNK, dtype=np.int32),
        "state_steps": np.arange(steps, dtype=np.int32),
    }
    for prefix in ("left_", "right_"):
        phase, pace = generator.uniform(0, 6, 6), generator.uniform(0.3, 1.2, 6)
        wanted = np.sin(phase + pace * time)
        curves[f"action.{prefix}arm_joint_state"] = wanted.astype(np.float32)
        curves[f"state.{prefix}arm_joint_state"] = np.sin(phase + pace * (time - 0.08)).astype(np.float32)
        gripper = (np.sin(time * 2 + phase[0]) > 0).astype(np.float32)
        curves[f"action.{prefix}ee_joint_state"] = gripper
        curves[f"state.{prefix}ee_joint_state"] = np.clip(gripper * 0.9 + 0.05, 0, 1)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **curves)
    return buffer.getvalue()


def _film(index: int) -> bytes:
    from PIL import Image

    frames = []
    for moment in range(12):
        picture = np.full((120, 160, 3), 232, np.uint8)
        picture[80:] = (186, 170, 150)
        left = 20 + 8 * moment
        picture[60 - moment : 80 - moment, left : left + 20] = (200, 60 + 10 * (index % 8), 50)
        frames.append(Image.fromarray(picture))
    buffer = io.BytesIO()
    frames[0].save(buffer, "webp", save_all=True, append_images=frames[1:], duration=80, loop=0)
    return buffer.getvalue()


def _beside(folder: Path, name: str, content: bytes) -> dict[str, str]:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return {"path": name, "digest": hashlib.sha256(content).hexdigest()}


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _time(moment: dt.datetime) -> str:
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
