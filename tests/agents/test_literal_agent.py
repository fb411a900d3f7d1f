"""An agent that follows the integrate skill to the letter takes policies that nobody here knows to parity with them."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.outside import literal_agent
from tests.support.outside.literal_agent import Answers, GapError, LiteralAgent
from xpl.embodiment import get_embodiment
from xpl_cli.agents.skills.bundle import Bundle, bundles, chosen

NEWCOMERS = Path(__file__).parent / "newcomers"
TORCH = "XPL_TORCH_PYTHON"
"""Names a Python with PyTorch and numpy, where the tests' own has none."""
ABOUT = ("A policy made for a test; it was never trained.", "made by the test, nothing is published", "None yet.")
FACTS = {
    "family": "other",
    "paper": None,
    "upstream": None,
    "license": "Apache-2.0",
    "control_frequency": 25,
}


def _vector(file: str, name: str, arms: tuple[str, ...] = ("single",), opened: float = 1.0) -> dict[str, Any]:
    """Return the joints and grippers of some arms in a native block, normalised if there is a file of statistics."""
    hands = (
        ({"joints": {"arm": arm}} for arm in arms),
        ({"gripper": {"arm": arm, "closed": 0.0, "open": opened}} for arm in arms),
    )
    names = {"mean": f"{name}_mean", "std": f"{name}_std"}
    normalize = {"normalize": {"rule": "mean_std", "file": file, "names": names}} if file else {}
    return {"parts": [part for pair in zip(*hands, strict=True) for part in pair], **normalize}


def _linear(folder: Path) -> Answers:
    """One arm; an affine map of the normalised state, in numpy."""
    robot = get_embodiment("arx_x5_single")
    width, chunk = sum(robot.dims("joint").values()), 5
    generator = np.random.default_rng(11)
    matrix = np.tile(0.97 * np.eye(width), chunk) + generator.normal(0, 0.002, (width, width * chunk))
    arm = robot.arms[0]
    middle = np.append((arm.lower + arm.upper) / 2, 0.5)
    np.savez(
        folder / "linear.npz",
        matrix=matrix,
        offset=generator.normal(0, 0.002, width * chunk),
        state_mean=middle,
        state_std=np.full(width, 0.5),
        action_mean=middle,
        action_std=np.full(width, 0.5),
    )
    return Answers(
        values={
            "NAME": "Leaner",
            "ROBOT": robot.name,
            "CONTROL": "joint",
            "CHUNK": str(chunk),
            "TASK": "lift_cube",
            "BUILD": "Linear",
        },
        sections=frozenset({"Skeleton", "Weights", "A network"}),
        manifest={
            **FACTS,
            "summary": "An affine map of the joint state.",
            "native": {
                "state": [{"input": "state", **_vector("linear.npz", "state")}],
                "action": {"reference": "absolute", **_vector("linear.npz", "action")},
            },
        },
        about=ABOUT,
        code=(NEWCOMERS / "linear.py", "network.py"),
        native=NEWCOMERS / "linear_native.py",
        weights=folder / "linear.npz",
    )


def _mlp(folder: Path) -> Answers:
    """One arm; a perceptron over three observations, in the Python that has PyTorch."""
    robot = get_embodiment("franka_single")
    width, chunk, frames, hidden = sum(robot.dims("joint").values()), 4, 3, 16
    arm = robot.arms[0]
    middle, scale = np.append((arm.lower + arm.upper) / 2, 0.5).tolist(), [0.5] * width
    made = f"""
import torch
torch.manual_seed(11)
inner, outer = torch.nn.Linear({width * frames}, {hidden}), torch.nn.Linear({hidden}, {width * chunk})
weights = {{f"layers.{{place}}.{{name}}": value.detach() for place, layer in ((0, inner), (2, outer))
           for name, value in layer.named_parameters()}}
torch.save({{"width": {width}, "steps": {chunk}, "frames": {frames}, "hidden": {hidden}, "weights": weights}}, "mlp.pt")
"""
    numbers = {
        f"{name}_{kind}": value for name in ("state", "action") for kind, value in (("mean", middle), ("std", scale))
    }
    (folder / "statistics.json").write_text(json.dumps(numbers))
    python = _torch_python()
    subprocess.run([python, "-c", made], cwd=folder, check=True)
    return Answers(
        values={
            "NAME": "Recaller",
            "ROBOT": robot.name,
            "CONTROL": "joint",
            "CHUNK": str(chunk),
            "TASK": "lift_cube",
            "BUILD": "Perceptron",
            "WEIGHTS": "weights",
            "INPUT": "frames",
        },
        sections=frozenset({"Skeleton", "A network in PyTorch", "A history in one vector"}),
        manifest={
            **FACTS,
            "summary": "A perceptron over the last three joint states.",
            "temporal": {"kind": "history", "history": frames, "chunk": chunk},
            "native": {
                "state": [{"input": "frames", **_vector("statistics.json", "state")}],
                "history": {"length": frames},
                "action": {"reference": "absolute", **_vector("statistics.json", "action")},
            },
            "environment": {"manager": "path", "python": python},
        },
        about=ABOUT,
        code=(NEWCOMERS / "mlp.py", "network.py"),
        native=NEWCOMERS / "mlp_native.py",
        weights=folder / "mlp.pt",
        beside=(folder / "statistics.json",),
    )


def _tinted(folder: Path) -> Answers:
    """Two arms; reads a small picture in BGR, and grippers from 0 to 0.085 m."""
    robot = get_embodiment("arx_x5")
    chunk, opened = 6, 0.085
    rest = np.concatenate([np.append((arm.lower + arm.upper) / 2, opened / 2) for arm in robot.arms])
    gain = np.random.default_rng(11).normal(0, 0.3, (3, len(rest)))
    gain[:, [arm.dof for arm in robot.arms[:1]] + [len(rest) - 1]] *= opened / 10
    np.savez(folder / "tinted.npz", rest=rest, gain=gain, steps=chunk)
    return Answers(
        values={
            "NAME": "Bluish",
            "ROBOT": robot.name,
            "CONTROL": "joint",
            "CHUNK": str(chunk),
            "TASK": "lift_cube",
            "BUILD": "Tinted",
        },
        sections=frozenset({"Skeleton", "Weights", "A network"}),
        manifest={
            **FACTS,
            "summary": "Follows the tint of the picture.",
            "inputs": {
                "required": ["state.arm_joint_state", "state.ee_joint_state", "vision.cam_head"],
                "optional": [],
                "unused": ["instruction", "vision.cam_left_wrist", "vision.cam_right_wrist"],
            },
            "cameras": {"cam_head": {"width": 24, "height": 18}},
            "native": {
                "images": [
                    {
                        "input": "image",
                        "cameras": ["cam_head"],
                        "steps": [{"resize": {"to": [18, 24], "filter": "bilinear", "antialias": True}}],
                        "channels": "bgr",
                        "layout": "chw",
                        "dtype": "float32",
                        "range": [0, 1],
                    }
                ],
                "state": [{"input": "proprio", **_vector("", "state", ("left", "right"), opened)}],
                "action": {"reference": "absolute", **_vector("", "action", ("left", "right"), opened)},
            },
        },
        about=ABOUT,
        code=(NEWCOMERS / "tinted.py", "network.py"),
        native=NEWCOMERS / "tinted_native.py",
        weights=folder / "tinted.npz",
    )


def _torch_python() -> str:
    """Return a Python that has PyTorch; skip the test where there is none."""
    named = os.environ.get(TORCH)
    if named is None and importlib.util.find_spec("torch"):
        return sys.executable
    if named is None:
        pytest.skip(f"PyTorch is not installed; {TORCH} may name a Python that has it")
    return named


@pytest.fixture
def agent(tmp_path: Path) -> Callable[[Callable[[Path], Answers]], LiteralAgent]:
    """Return a function that sets an agent to work on a newcomer in an empty project."""

    def make(newcomer: Callable[[Path], Answers]) -> LiteralAgent:
        upstream, project = tmp_path / "upstream", tmp_path / "project"
        upstream.mkdir()
        project.mkdir()
        return LiteralAgent(newcomer(upstream), project, SKILL)

    return make


SKILL = chosen([literal_agent.SKILL])[0]
WRITTEN, PLAYED = 5, len(literal_agent.steps(SKILL))
"""Steps after which the text is right, and all is done."""


@pytest.mark.sampled(1)
@pytest.mark.parametrize("newcomer", [_linear, _tinted, _mlp])
def test_the_skill_leads_to_a_sound_package(
    agent: Callable[..., LiteralAgent], newcomer: Callable[[Path], Answers]
) -> None:
    """Quick part of the route: package, manifest, weights, model.py, and a static gate that is green."""
    one = agent(newcomer)
    one.follow(until=WRITTEN)
    assert one.runs[-1].command.endswith("--gate static")
    assert "XPL-FINISH gate=static pass" in one.runs[-1].output


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("newcomer", [_linear, _tinted, _mlp])
def test_the_skill_leads_from_nothing_to_green(
    agent: Callable[..., LiteralAgent], newcomer: Callable[[Path], Answers]
) -> None:
    """All of the route, to the letter: every command ends with 0 and shows what the text says that is to be seen.

    It ends in parity with the authors' own code, and no conversion was written by hand.
    """
    one = agent(newcomer)
    one.follow(until=PLAYED)
    whole = next(run for run in one.runs if run.command == f"xpl audit policy/{one.answers.values['NAME']}")
    for gate in ("static", "offline", "mujoco"):
        assert f"XPL-FINISH gate={gate} pass" in whole.output
    proven = r"verdict GREEN contract, parity \(\d+ pairs, no convention assumed\)"
    assert re.search(proven, " ".join(whole.output.split()))
    assert "profile=shadow" not in whole.output
    told, _ = json.JSONDecoder().raw_decode(
        one.run("xpl audit POLICY --gate static --gate offline --select XPL19 --select XPL26 --json")
    )
    results = {result["code"]: result for gate in told["targets"][0]["gates"] for result in gate["results"]}
    assert {results[f"XPL{number}"]["outcome"] for number in (192, 193, 194, 195, 260, 261)} == {"pass"}
    assert results["XPL260"]["proof"]["pairs"] > 0
    assert results["XPL260"]["proof"]["assumed"] == 0
    model = ast.parse((one.package / "model.py").read_text(encoding="utf-8"))
    assert [node.name for node in ast.walk(model) if isinstance(node, ast.FunctionDef)] == ["load", "predict"]


# -- the agent itself --------------------------------------------------------------------------------------------------


def test_every_step_is_understood() -> None:
    """What the agent reads out of the steps is what is written there."""
    found = literal_agent.steps(SKILL)
    assert len(found) == SKILL.body.count("- [ ] ")
    told = sum(len(step.commands) for step in found)
    part = SKILL.body.split("## Steps")[1].split("## ")[0]
    assert told == len(re.findall(r"^xpl ", part, re.MULTILINE)) > 5
    whole = next(step for step in found if step.commands == ("xpl audit POLICY",))
    assert whole.seen == ("verdict GREEN contract",)


@pytest.mark.slow
def test_an_answer_that_the_text_has_no_place_for_stops_the_agent(agent: Callable[..., LiteralAgent]) -> None:
    """It invents nothing: neither a section nor a key."""
    one = agent(_linear)
    lost = Answers(**{**vars(one.answers), "sections": frozenset({"Skeleton", "Telepathy"})})
    with pytest.raises(GapError, match="Telepathy"):
        LiteralAgent(lost, one.project, SKILL).follow(until=WRITTEN)


def test_a_command_that_fails_stops_the_agent(agent: Callable[..., LiteralAgent]) -> None:
    """It goes on only after what the text says that is to be seen."""
    one = agent(_linear)
    unknown = Answers(**{**vars(one.answers), "values": {**one.answers.values, "ROBOT": "arx_x6"}})
    with pytest.raises(GapError, match="ended with 3"):
        LiteralAgent(unknown, one.project, SKILL).follow(until=1)


@pytest.mark.parametrize("skill", bundles(), ids=lambda skill: skill.name)
def test_no_skill_was_written_for_these_policies(skill: Bundle) -> None:
    """Neither their names nor their numbers stand in any text that an agent reads."""
    text = skill.text(full=True).lower()
    names = {"leaner", "recaller", "bluish", "perceptron", "tinted", "tint", "proprio", "0.085"}
    assert {name for name in names if re.search(rf"\b{re.escape(name)}\b", text)} == set()
