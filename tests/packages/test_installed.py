"""Environments and robots of installed packages: names that are taken and files that are wrong are told in a line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.commands import xpl
from tests.support.distributions import Install, installing
from xpl.registry import EntryPointError
from xpl.robots import registry as robots
from xpl_cli.packages import environments
from xpl_cli.packages import robots as packages
from xpl_cli.packages.environments import find

ENV = "spec: v1\nname: {name}\n"
ROBOT = """\
name: {name}
description: An arm.
arms: [single]
{rest}
"""
LIKE = ROBOT.format(name="other_arm", rest="like: one_arm")
WHOLE = ROBOT.format(
    name="one_arm",
    rest="arm: {dof: 1, home: null, joints: null}\nend_effector: {kind: parallel_gripper, dim: 1, stroke: null}",
)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Return a function that installs a distribution; what it makes known is forgotten afterwards."""
    monkeypatch.setattr(robots, "_offered", {})
    monkeypatch.setattr(robots, "_heard", [])
    monkeypatch.setattr(packages, "_read", {})
    monkeypatch.setenv(robots.HANDED_ON, "")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    with installing(tmp_path, monkeypatch) as made:
        yield made


def bring(install: Install, distribution: str, name: str) -> Path:
    """Install a package with an environment."""
    package = f"{distribution}_pkg"
    points = f"[xpl.envs]\n{distribution} = {package}.envs\n"
    return install(distribution, points, {f"{package}/envs/{name}/env.yml": ENV.format(name=name)})


def test_an_environment_of_a_package_is_found_by_name_and_one_of_the_project_by_its_path(install: Install) -> None:
    site = bring(install, "bringer", "theirs")
    assert "theirs" in environments.names()
    assert find("theirs") == site / "bringer_pkg" / "envs" / "theirs"
    Path("envs/theirs").mkdir(parents=True)
    Path("envs/theirs/env.yml").write_text(ENV.format(name="theirs"))
    assert find("theirs") == site / "bringer_pkg" / "envs" / "theirs"
    assert find("envs/theirs") == Path.cwd() / "envs" / "theirs"


@pytest.mark.parametrize(
    ("name", "owners"), [("mujoco", ["first 1.0", "xpl"]), ("theirs", ["first 1.0", "second 1.0"])]
)
def test_two_environments_of_one_name_are_told_with_both_their_packages(
    install: Install, name: str, owners: list[str]
) -> None:
    for owner in owners:
        if owner != "xpl":
            bring(install, owner.partition(" ")[0], name)
    ended = xpl("env", "list", "--json")
    assert ended.code == 4
    said = json.loads(ended.stdout)["message"]
    assert "\n" not in said
    assert said.endswith(f"are both called {name}")
    assert all(f"of {owner} " in said for owner in owners)


def test_robots_of_a_package_may_be_like_one_another(install: Install) -> None:
    files = {"bringer_pkg/robots/other_arm.yml": LIKE, "bringer_pkg/robots/one_arm.yml": WHOLE}
    install("bringer", "[xpl.robots]\nbringer = bringer_pkg.robots\n", files)
    assert robots.canonical("other_arm") == "other_arm"
    read = robots.entries()["other_arm"]
    packages.register_robots()
    assert robots.entries()["other_arm"] == read
    assert read["arm"]["dof"] == 1


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (WHOLE.replace("dof: 1", "dof: one"), "dof"),
        (WHOLE.replace("description: An arm.", "aliases: [franka_single]"), "franka_single is taken"),
        (LIKE.replace("other_arm", "one_arm"), "one_arm"),
    ],
)
def test_a_robot_that_is_none_names_the_distribution(install: Install, text: str, told: str) -> None:
    install("bringer", "[xpl.robots]\nb = bringer_pkg.robots\n", {"bringer_pkg/robots/one_arm.yml": text})
    for learn in (packages.register_robots, lambda: robots.canonical("nobody")):
        with pytest.raises(EntryPointError, match=rf"of bringer 1.0 cannot be used: .*{told}"):
            learn()


def test_two_packages_with_one_robot_are_told(install: Install) -> None:
    for name in ("first", "second"):
        text = WHOLE.replace("An arm.", f"An arm of {name}.").replace("dof: 1", f"dof: {len(name)}")
        install(name, f"[xpl.robots]\n{name} = {name}_pkg.robots\n", {f"{name}_pkg/robots/one_arm.yml": text})
    with pytest.raises(EntryPointError, match=r"of (first|second) 1.0 cannot be used: .* of (first|second) 1.0"):
        packages.register_robots()
