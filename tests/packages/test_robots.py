"""Robots of a project are as good as the standard's: described once, known to every command and every process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl import get_embodiment, robots
from xpl.embodiment import UnknownEmbodimentError
from xpl.robots import registry
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.packages import robots as projects
from xpl_cli.packages.manifests import ManifestError

ARM = """\
name: desk_arm
aliases: [desk]
description: An arm that stands on a desk.
arms: [single]
arm:
  dof: 2
  home: [0.0, 0.5]
  joints:
    - { name: turn, limits: [-3.0, 3.0], velocity: 2.0, origin: { xyz: [0, 0, 0.1], rpy: [0, 0, 0] }, axis: [0, 0, 1] }
    - { name: lift, limits: [-1.0, 1.0], velocity: null, origin: { xyz: [0, 0, 0.2], rpy: [0, 0, 0] }, axis: [0, 1, 0] }
end_effector: { kind: parallel_gripper, dim: 1, stroke: null }
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the folder of a project with one robot of its own; what it makes known is forgotten afterwards."""
    monkeypatch.setattr(registry, "_offered", {})
    monkeypatch.setattr(projects, "_read", {})
    monkeypatch.setenv(robots.HANDED_ON, "")
    (tmp_path / "embodiments").mkdir()
    (tmp_path / "embodiments" / "desk_arm.yml").write_text(ARM)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_robot_of_the_project_is_found_by_all_its_names(project: Path) -> None:
    """With its dimensions and limits; processes that are started know it, too, without YAML."""
    projects.register_robots()
    robot = get_embodiment("desk")
    assert (robot.name, robot.arms[0].dof, robots.origin("desk_arm")) == ("desk_arm", 2, "embodiments/desk_arm.yml")
    assert robot.dims("joint") == {"arm_joint_state": 2, "ee_joint_state": 1}
    code = "import sys; sys.modules['yaml'] = None; from xpl import get_embodiment; print(get_embodiment('desk').name)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.stdout.strip() == "desk_arm"
    assert project.name  # the file is where the name says


@pytest.mark.slow
def test_it_is_scaffolded_audited_and_evaluated(project: Path) -> None:
    for command in (
        ("new-policy", "Desk", "--embodiment", "desk"),
        ("audit", "policy/Desk", "--gate", "static", "--no-cache"),
        ("eval", "policy/Desk", "--env", "offline", "--episodes", "1", "--horizon", "8"),
        ("new-env", "Room", "--embodiment", "desk_arm"),
        ("audit", "envs/Room", "--select", "env-runs", "--no-cache"),
    ):
        done = xpl(*command, cwd=project)
        assert done.returncode == ExitCode.CLEAN, (command, done.stdout, done.stderr)
    manifest = yaml.safe_load((project / "policy" / "Desk" / "policy.yml").read_text())
    assert manifest["embodiments"] == ["desk_arm"]
    listed = json.loads(xpl("spec", "show", "--json", cwd=project).stdout)["value"]["robots"]
    assert listed["desk_arm"]["from"] == "embodiments/desk_arm.yml"
    assert listed["so101"]["from"].startswith("spec/robots")


def test_an_audit_notices_that_a_robot_is_another_one(project: Path, tmp_path: Path) -> None:
    """Passes that were kept say nothing of a manifest whose robot has gone."""
    assert xpl("new-policy", "Desk", "--embodiment", "desk", cwd=project).returncode == ExitCode.CLEAN
    audit = ("audit", "policy/Desk", "--gate", "static", "--select", "manifest")
    assert xpl(*audit, cwd=project).returncode == ExitCode.CLEAN
    (project / "embodiments" / "desk_arm.yml").rename(project / "desk_arm.yml")
    done = xpl(*audit, cwd=project)
    assert done.returncode == ExitCode.FINDINGS
    assert "there is no embodiment of that name" in done.stdout


def test_a_package_brings_its_own(project: Path) -> None:
    (project / "elsewhere" / "envs" / "Room" / "embodiments").mkdir(parents=True)
    file = project / "elsewhere" / "envs" / "Room" / "embodiments" / "wall_arm.yml"
    file.write_text("name: wall_arm\nlike: so101\narms: [left, right]\narm: { home: [0, 0, 0, 0, 0] }\n")
    projects.register_robots(file.parent.parent)
    assert get_embodiment("wall_arm").arms[1].home is not None
    assert get_embodiment("wall_arm").arms[1].joint_names == get_embodiment("so101").arms[0].joint_names


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("franka", {}, "the name franka is taken by franka, which comes with xpl"),
        ("ours", {"aliases": ["so101_follower"]}, "so101_follower is taken by so101, which comes with xpl"),
        ("other", {"aliases": ["desk"]}, "desk is taken by desk_arm, which embodiments/desk_arm.yml describes"),
    ],
)
def test_a_name_that_is_taken_is_refused(name: str, change: dict[str, Any], said: str, project: Path) -> None:
    """Also an alias: nobody drives another robot than the one that was meant."""
    entry = {**yaml.safe_load(ARM), "aliases": [], "name": name, **change}
    (project / "embodiments" / f"{name}.yml").write_text(json.dumps(entry))
    with pytest.raises(UserError, match=said) as caught:
        projects.register_robots()
    assert caught.value.code == ExitCode.USAGE


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("dof: 2", "dof: 3", "DOF = 3"),
        (
            "limits: [-3.0, 3.0]",
            "limits: [3.0, -3.0]",
            r"embodiments/desk_arm.yml:9:\d+ .*expected \[from, to\] in rad",
        ),
        ("axis: [0, 0, 1]", "axis: [0, 0, 0]", r"axis: expected a direction, got \[0, 0, 0\]"),
        ("axis: [0, 0, 1]", "axis: [0, .nan, 1]", "axis: expected a direction"),
        ("name: desk_arm", "name: desk", "expected the file's name desk_arm"),
        ("kind: parallel_gripper", "kind: claw", "desk_arm.yml:11:"),
        ("arms: [single]", "arms: [left]", "desk_arm.yml:4:"),
        ("arms: [single]", "like: nobody\narms: [single]", "there is no robot 'nobody'"),
    ],
)
def test_a_file_that_is_wrong_is_told_with_its_line(old: str, new: str, said: str, project: Path) -> None:
    file = project / "embodiments" / "desk_arm.yml"
    file.write_text(ARM.replace(old, new))
    with pytest.raises(ManifestError, match=said):
        projects.register_robots()


@pytest.mark.parametrize(
    ("robots", "said"),
    [
        ({f"r{number}": {"like": f"r{number + 1}"} for number in range(2000)}, "describes 2001 robots, expected 64"),
        (
            {f"r{number}": {"like": "so101", "description": "x" * 40_000} for number in range(40)},
            "1048576 at most in all",
        ),
        ({"wordy": {"like": "so101", "description": "x" * 200_000}}, "wordy.yml: .* as JSON, expected 98304 at most"),
    ],
    ids=["a chain", "long files", "long words"],
)
def test_robots_that_are_too_many_or_too_long_are_refused(
    robots: dict[str, dict[str, Any]], said: str, project: Path
) -> None:
    """All are read by every command, and handed on in a variable, with which no process would start any more."""
    for name, entry in robots.items():
        told = {"name": name, "arms": ["single"], **entry}
        (project / "embodiments" / f"{name}.yml").write_text(json.dumps(told))
    with pytest.raises(UserError, match=said) as caught:
        projects.register_robots()
    assert caught.value.code == ExitCode.USAGE
    assert not set(registry._offered) & set(robots)


def test_the_command_that_checks_files_tells_it(project: Path) -> None:
    """And holds a robot that is like another one as a whole."""
    file = project / "embodiments" / "mine.yml"
    file.write_text("name: mine\nlike: so101\narms: [single]\narm: { dof: 6 }\n")
    done = xpl("spec", "validate", "embodiments/mine.yml", cwd=project)
    assert done.returncode == ExitCode.FINDINGS
    assert "embodiments/mine.yml:4:" in done.stdout


def test_a_recorded_run_describes_its_robot(project: Path) -> None:
    """Who plays it again meets the same robot, or is told that it is another one."""
    projects.register_robots()
    config = projects.recorded_description("desk_arm")
    assert projects.recorded_description("so101") == {}
    registry._offered.clear()
    projects.register_recorded(config, "run 0123")
    assert get_embodiment("desk_arm").arms[0].dof == 2
    other = {projects.DESCRIPTION: {**config[projects.DESCRIPTION], "description": "another"}}
    with pytest.raises(UserError, match="another robot here than in run 0123"):
        projects.register_recorded(other, "run 0123")
    for strange in ([], {"name": "x", "aliases": 3}, {"name": "x", "like": 4}, {"name": "so101", "like": "franka"}):
        with pytest.raises(UserError):
            projects.register_recorded({projects.DESCRIPTION: strange}, "run 0123")


def test_a_file_can_be_read_without_the_tool(project: Path) -> None:
    (project / "desk_arm.json").write_text(json.dumps(yaml.safe_load(ARM)))
    assert robots.load(project / "desk_arm.json") == robots.load("embodiments/desk_arm.yml") == "desk_arm"
    (project / "bad.json").write_text("[1]")
    with pytest.raises(robots.RobotError, match="expected a map"):
        robots.load(project / "bad.json")


def test_words_of_benchmarks_stand_for_robots() -> None:
    """Every word leads to a robot that has as many numbers as the benchmark commands."""
    for word, numbers in (("aloha-agilex", 14), ("ur5_wsg", 14), ("ur5-wsg", 14), ("ARX-X5", 14), ("franka-panda", 16)):
        assert sum(get_embodiment(word).dims("joint").values()) == numbers, word
    assert get_embodiment("so101_follower").name == "so101"
    with pytest.raises(UnknownEmbodimentError, match="did you mean"):
        get_embodiment("so_101")


def test_a_name_whose_words_stand_in_another_order_is_meant() -> None:
    with pytest.raises(UnknownEmbodimentError, match=r"did you mean arx_x5_single\?"):
        get_embodiment("single_arx_x5")


def test_a_checkout_names_robots_by_their_dimensions(tmp_path: Path) -> None:
    """Those that the standard does not know become robots of these dimensions; what cannot be one is left out."""
    adapter = tmp_path / "XPolicyLab" / "policy" / "Foo"
    adapter.mkdir(parents=True)
    (adapter.parents[1] / "model_template.py").write_text("")
    known = {
        "two_handed_thing": {"arm_dim": [5, 5], "ee_dim": [2, 2]},
        "one_armed_thing": {"arm_dim": [9], "ee_dim": [1]},
        "franka": {"arm_dim": [3, 3], "ee_dim": [1, 1]},
        "uneven_thing": {"arm_dim": [5, 6], "ee_dim": [1, 1]},
        "../thing": {"arm_dim": [5], "ee_dim": [1]},
        "no_thing": "unknown",
    }
    path = adapter.parents[1] / "utils" / "robot" / "_robot_info.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(known))
    projects.register_robots(adapter)
    two, one = get_embodiment("two_handed_thing"), get_embodiment("one_armed_thing")
    assert ([arm.dof for arm in two.arms], [arm.ee_dim for arm in two.arms]) == ([5, 5], [2, 2])
    assert ([arm.dof for arm in one.arms], one.prefixes) == ([9], ("",))
    assert [arm.dof for arm in get_embodiment("franka").arms] == [7, 7]
    for name in ("uneven_thing", "no_thing", "../thing"):
        with pytest.raises(UnknownEmbodimentError):
            get_embodiment(name)
    path.write_text("{")
    projects.register_robots(adapter)  # of a file that is none, nothing is said
