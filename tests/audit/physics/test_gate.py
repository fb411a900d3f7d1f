"""The MuJoCo gate: what it drives, what it measures and films, and that it repeats."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image, ImageSequence

from tests.support.peer import xpl
from xpl import _spec as sdk
from xpl import get_embodiment
from xpl.kinematics import Chain
from xpl_cli.audit.engine import engine
from xpl_cli.audit.formats import as_json, render
from xpl_cli.audit.formats.listing import ReportContext
from xpl_cli.audit.physics.conventions import mismatches
from xpl_cli.audit.physics.rollout import PhysicsInference
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.physics.swaps import CAMERAS, COLOURS, EnvSwap, image_swaps
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.measurements import RolloutSetup
from xpl_cli.audit.rules.model import NotApplicable, Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.served.probe import Probe
from xpl_cli.basics import content
from xpl_cli.basics.errors import ExitCode
from xpl_cli.packages import environments
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl_cli.audit.rules.model import GateReport

OPTIONS = AuditOptions(gates=(Gate.MUJOCO,))
WRITTEN = dict[str, Any]


@pytest.fixture
def package(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a scaffold: text to replace in policy.yml, and text for its end."""

    def write(edits: dict[str, str] | None = None, end: str = "", **answers: Any) -> Path:
        folder = tmp_path / "Subject"
        filled = AdapterAnswers(**{**adapter.defaults(), "block": False, "name": folder.name, **answers})
        adapter.write(adapter.render(filled), folder)
        manifest = folder / sdk.File.POLICY_YML
        text = manifest.read_text()
        for old, new in (edits or {}).items():
            assert old in text
            text = text.replace(old, new)
        manifest.write_text(text + end)
        return folder

    return write


def gate(folder: Path, *names: str, **options: Any) -> GateReport:
    """Run rules of the gate."""
    (report,) = engine.audit(folder, "policy", replace(OPTIONS, names=names, **options)).gates
    return report


def courses(folder: Path, options: AuditOptions = OPTIONS) -> tuple[RolloutSetup, ...]:
    """Return what would be driven, without serving anything."""
    with Probe.start(folder, options) as probe:
        return Simulation(probe).setups


# -- what is driven ----------------------------------------------------------------------------------------------------


def test_every_declared_pair_that_the_environment_offers_is_driven(package: Callable[..., Path]) -> None:
    """The configured one first, and in one task of each capability dimension; robots that it lacks are left out."""
    edits = {
        "embodiments: [arx_x5]": "embodiments: [arx_x5, franka, franka_single]",
        "action_types: [joint]": "action_types: [joint, ee]",
    }
    found = courses(package(edits))
    pairs = list(dict.fromkeys((course.embodiment, course.action_type) for course in found))
    assert pairs == [(robot, kind) for robot in ("arx_x5", "franka_single") for kind in ("joint", "ee")]
    tasks = environments.manifest(environments.find("mujoco")).tasks
    several = [course.task for course in found if (course.embodiment, course.action_type) == pairs[0]]
    assert sorted(str(tasks[task].dimension) for task in several) == sorted({str(t.dimension) for t in tasks.values()})
    assert len(found) == len(several) + len(pairs) - 1


def test_tasks_are_those_that_are_asked_for_or_claimed(package: Callable[..., Path]) -> None:
    """What the command says counts before what the manifest claims, and that before our own choice."""
    folder = package(end="claims:\n  - {environment: mujoco, task: peg_insert, success_rate: 0.5}\n")
    assert [course.task for course in courses(folder)] == ["peg_insert"]
    asked = replace(OPTIONS, tasks=("push_block", "lift_cube"))
    assert [course.task for course in courses(folder, asked)] == ["push_block", "lift_cube"]


def test_a_robot_that_the_environment_lacks_is_not_applicable(package: Callable[..., Path]) -> None:
    folder = package(embodiment="tianji_marvin_wuji")
    with pytest.raises(NotApplicable, match="no tianji_marvin_wuji; it has arx_x5"):
        courses(folder)
    assert gate(folder).outcome is Outcome.NOT_APPLICABLE


def test_an_unknown_task_is_refused_at_once(package: Callable[..., Path], tmp_path: Path) -> None:
    done = xpl("audit", str(package()), "--gate", "mujoco", "--task", "fold_shirt", cwd=tmp_path)
    assert done.returncode == ExitCode.NOT_FOUND
    assert "lift_cube" in done.stderr


# -- what comes of it --------------------------------------------------------------------------------------------------


def test_a_robot_that_is_told_to_be_where_it_is_stays_there(package: Callable[..., Path]) -> None:
    """The environment keeps the convention that it holds policies to: the flange of a held pose moves by under 2 mm."""
    with Probe.start(package(action_type="ee"), replace(OPTIONS, tasks=("lift_cube",))) as probe:
        (played,) = Simulation(probe).sound_rollouts()
    places = [query.state["left_ee_pose"] for query in played.inferences[0]]
    assert np.linalg.norm(places[-1][:3] - places[0][:3]) < 0.002
    assert not any(played.corrections[0])


@pytest.mark.slow
def test_success_is_reported_with_its_interval(package: Callable[..., Path]) -> None:
    """In the report for people, as JSON that its schema allows, and judged only where something is claimed."""
    report = engine.audit(package(), "policy", replace(OPTIONS, names=("claimed-success",), episodes=2))
    (found,) = report.gates
    assert found.outcome is Outcome.NOT_APPLICABLE
    (figure,) = found.measurements
    assert (figure.successes, figure.episodes) == (0, 2)
    assert str(figure) in render("text", [report], ReportContext())
    document = as_json([report], ReportContext())
    assert validate(document, "audit") == []
    (entry,) = document["targets"][0]["gates"][0]["figures"]
    assert entry["success_interval"] == pytest.approx([0, 0.6576], abs=1e-4)


@pytest.mark.slow
def test_a_claim_is_measured_as_it_says(package: Callable[..., Path]) -> None:
    """Its task, robot, kind of action and setting; one that was exceeded is none either."""
    claim = "{environment: mujoco, task: push_block, embodiment: piper, action_type: ee, setting: randomized, "
    declared = {
        "embodiments: [arx_x5]": "embodiments: [arx_x5, piper]",
        "action_types: [joint]": "action_types: [joint, ee]",
    }
    folder = package(declared, end=f"claims:\n  - {claim}success_rate: 0.9, episodes: 4}}\n")
    found = gate(folder, "claimed-success")
    assert found.outcome is Outcome.FAIL
    assert found.measurements[0].setup == RolloutSetup("push_block", "piper", "ee", "randomized")
    assert found.measurements[0].episodes == 4


@pytest.mark.slow
def test_a_shadow_is_held_to_what_any_model_has_to_do(package: Callable[..., Path]) -> None:
    report = gate(package(), profile=Profile.SHADOW, tasks=("push_block",))
    asked = {result.slug for result in report.results if result.outcome is not Outcome.NOT_APPLICABLE}
    assert asked == {
        "closed-loop",
        "same-seed-same-motion",
        "batch-motion",
        "newest-observation",
        "evaluation-loop-runs",
    }
    assert report.outcome is Outcome.PASS
    assert report.measurements == ()


def test_an_adapter_that_dies_in_the_loop_is_a_finding(package: Callable[..., Path]) -> None:
    """Neither a crash of the rule nor a check that could not run."""
    folder = package()
    with (folder / sdk.File.MODEL_PY).open("a") as model:
        model.write(
            "\n    def predict(self, inputs, envs):\n        import os\n\n"
            "        self.asked = getattr(self, 'asked', 0) + 1\n        if self.asked > 2:\n            os._exit(3)\n"
            "        return np.repeat(np.stack(inputs)[:, None], self.chunk, axis=1)\n"
        )
    (result,) = gate(folder, "closed-loop", tasks=("push_block",)).results
    assert result.outcome is Outcome.FAIL
    assert "fails after" in result.findings[0].message


@pytest.mark.slow
def test_two_runs_print_the_same_finish_line(package: Callable[..., Path]) -> None:
    """The digest holds every answer and every trajectory, and no time."""
    folder = package()
    finishes = {gate(folder, "closed-loop", "control-rate", tasks=("push_block",)).finish for _ in range(2)}
    assert len(finishes) == 1


@pytest.mark.slow
def test_every_episode_is_filmed(package: Callable[..., Path], tmp_path: Path) -> None:
    films = tmp_path / "films"
    done = xpl(
        "audit", str(package()), "--gate", "mujoco", "--select", "closed-loop", "--task", "push_block",
        "--video", str(films), "--json", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == ExitCode.CLEAN, done.stdout + done.stderr
    (film,) = films.iterdir()
    assert film.name == "Subject-push_block-arx_x5-joint-seed0.webp"
    with Image.open(film) as shown:
        lasts = 0
        for frame in ImageSequence.Iterator(shown):
            frame.load()
            lasts += frame.info["duration"]  # equal pictures are one frame that lasts longer
    assert lasts == 1000 * 2 / 25 * (64 // 2 + 1)
    assert validate(json.loads(done.stdout), "audit") == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo_policy", "scripted_expert"])
def test_our_own_policies_are_green(name: str) -> None:
    """With every robot and action type that they declare; a busy machine keeps up with no loop."""
    results = gate(content.content_folder("policy") / name, ignore=("control-rate",)).results
    assert {result.outcome for result in results} == {Outcome.PASS, Outcome.NOT_APPLICABLE}, results


@pytest.mark.slow
@pytest.mark.parametrize("arms", [1, 2])
def test_a_fresh_scaffold_is_green_in_physics(arms: int, package: Callable[..., Path]) -> None:
    """With every robot of the environment that has as many arms, and both kinds of action."""
    offered = environments.manifest(environments.find("mujoco")).embodiments
    robots = [name for name in offered if len(get_embodiment(name).arms) == arms]
    edits = {
        f"embodiments: [{robots[0]}]": f"embodiments: [{', '.join(robots)}]",
        "action_types: [joint]": "action_types: [joint, ee]",
    }
    folder = package(edits, embodiment=robots[0])
    assert {(course.embodiment, course.action_type) for course in courses(folder)} == {
        (robot, kind) for robot in robots for kind in sdk.ACTION_TYPES
    }
    report = gate(folder, ignore=("control-rate",))  # a busy machine keeps up with no loop
    assert report.outcome is Outcome.PASS, report.results
    assert not [result for result in report.results if result.findings]


# -- what it is made of ------------------------------------------------------------------------------------------------


def queries(action: Callable[[int], np.ndarray], state: WRITTEN) -> list[PhysicsInference]:
    """Return four questions at one state, answered by chunks of one step."""
    return [PhysicsInference(step, state, action(step)[None].astype(np.float32), 0.0) for step in range(4)]


@pytest.fixture
def arm_state() -> WRITTEN:
    """What is observed of one arm, somewhere in the world."""
    robot = get_embodiment("franka_single")
    joints = np.array([0.2, -0.1, 0.1, -2.4, 0.3, 2.3, 0.785])
    chain = Chain.from_embodiment(robot.data)
    flange = chain.flange(joints) + np.array([0.3, -0.2, 0.765, 0, 0, 0, 0])
    tcp = chain.tcp_from_flange(flange)
    return {"arm_joint_state": joints, "ee_joint_state": np.ones(1), "ee_pose": flange, "tcp_pose": tcp}


def test_one_answer_in_another_convention_is_no_mistake(arm_state: WRITTEN) -> None:
    """Only what explains every answer is: a policy may pass any place once."""
    robot = get_embodiment("franka_single")
    there, here = (np.append(arm_state[key], 1.0) for key in ("tcp_pose", "ee_pose"))
    assert [found.what for found in mismatches(robot, "ee", queries(lambda _: there, arm_state))] == [
        "the TCP between the fingertips"
    ]
    assert not list(mismatches(robot, "ee", queries(lambda step: here if step == 2 else there, arm_state)))
    assert not list(mismatches(robot, "ee", queries(lambda _: here, arm_state)[:1]))


@pytest.mark.parametrize(
    ("said", "what"),
    [
        (lambda state: np.degrees(state["left_arm_joint_state"]), "joint angles in degrees"),
        (lambda state: state["right_arm_joint_state"], "the pose of the other arm"),
    ],
)
def test_joints_in_another_convention_are_told(said: Callable[[WRITTEN], np.ndarray], what: str) -> None:
    """Of the arm whose commands they are; the other one holds its pose."""
    robot = get_embodiment("arx_x5")
    state = {
        "left_arm_joint_state": np.array([0.2, 1.1, 0.9, -0.8, 0.1, 0.3]),
        "right_arm_joint_state": np.array([-0.4, 0.9, 1.2, -0.5, 0.0, 0.1]),
    }
    action = np.concatenate([said(state), [1.0], state["right_arm_joint_state"], [1.0]])
    (found,) = mismatches(robot, "joint", queries(lambda _: action, state))
    assert (found.key, found.what) == ("left_arm_joint_state", what)


def test_a_mirrored_world_exchanges_pictures_and_nothing_else() -> None:
    """Red and blue of all, or two cameras; wrists are the first pair that is tried, and grippers come after them."""
    robot = get_embodiment("arx_x5")
    env = environments.make("mujoco", {"task": "lift_cube", "embodiment": "arx_x5"})
    env.reset([1])
    (real,) = env.get_obs_batch([0])
    cameras = list(real["vision"])
    colours, wrists, *_ = image_swaps(cameras)
    assert (colours, wrists) == (EnvSwap(COLOURS), EnvSwap(CAMERAS, ("cam_left_wrist", "cam_right_wrist")))
    (seen,) = colours.apply_to(env, robot).get_obs_batch([0])
    for name in cameras:
        assert np.array_equal(seen["vision"][name]["color"], real["vision"][name]["color"][..., ::-1])
    (seen,) = wrists.apply_to(env, robot).get_obs_batch([0])
    came_from = {"cam_left_wrist": "cam_right_wrist", "cam_right_wrist": "cam_left_wrist", "cam_head": "cam_head"}
    for name, other in came_from.items():
        assert np.array_equal(seen["vision"][name]["color"], real["vision"][other]["color"])
    assert all(np.array_equal(seen["state"][key], value) for key, value in real["state"].items())
