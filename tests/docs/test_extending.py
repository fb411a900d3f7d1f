"""docs/extending.md: its package is built, installed, and found by its commands."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import commands
from tests.support.distributions import forget
from xpl import Client, get_embodiment
from xpl.client import PolicyServerError
from xpl_cli.data.reading import open_set
from xpl_cli.standard.validate import validate

REPO = Path(__file__).parents[2]
Run = Callable[..., commands.Ended]
PAGE = (REPO / "docs" / "extending.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```\w+ title=\"(.+?)\"\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where the page's package is installed, built by pip from the page's files."""
    source, target = tmp_path_factory.mktemp("xpl-tiny"), tmp_path_factory.mktemp("site")
    for name, text in FILES.items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "--no-index", "--no-deps", "--no-build-isolation", "--quiet"]
    subprocess.run([*pip, "--target", str(target), str(source)], check=True, timeout=100)
    return target


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Have the package in this process, too."""
    monkeypatch.syspath_prepend(site)
    forget()
    yield
    monkeypatch.undo()
    forget()


@pytest.fixture
def xpl(installed: None, tmp_path: Path) -> Run:
    """Return a function that runs the command line where the package is installed, in an empty folder."""

    def run(*arguments: str | Path, code: int = 0) -> commands.Ended:
        done = commands.xpl(*arguments, folder=tmp_path)
        assert done.code == code, done.stdout + done.stderr
        return done

    return run


# -- a wire ------------------------------------------------------------------------------------------------------------

STATE = """
    import numpy as np
    from xpl import Policy
    from xpl.observation import get_instruction, pack_state

    class Model(Policy):
        def load(self, config):
            self.count = 0

        def reset_env(self, env):
            self.count = 0

        def encode(self, obs, env):
            if get_instruction(obs) == "fall over":
                raise ValueError("the gripper is unhappy")
            return pack_state(obs, self.embodiment, self.action_type)

        def predict(self, inputs, envs):
            self.count += 1
            return [np.stack([np.r_[self.count, row[1:]]] * 2) for row in inputs]
"""


def observation(number: float, **others: Any) -> dict[str, Any]:
    """Return what an environment shows."""
    robot = get_embodiment("franka_single")
    state = {key: np.full(width, number, np.float32) for key, width in robot.dims("joint").items()}
    cameras = {name: {"color": np.zeros((4, 4, 3), np.uint8)} for name in robot.cameras}
    return {"state": state, "vision": cameras, "instruction": "go", **others}


@pytest.fixture
def server(site: Path, write_adapter: Callable[..., Path]) -> Iterator[dict[str, Any]]:
    """Serve an adapter to clients of the page's wire, too; return what the server says of itself."""
    folder = write_adapter(STATE, temporal={"chunk": 2})
    command = [sys.executable, "-m", "xpl_cli", "serve", str(folder), "--port", "0", "--also", "tiny"]
    with subprocess.Popen(
        [*command, "--until-stdin-ends"],
        env={**os.environ, "PYTHONPATH": f"{site}:{REPO}"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())
        process.stdin.close()


@pytest.mark.usefixtures("installed")
def test_a_wire_of_a_package_is_served_and_spoken(server: dict[str, Any]) -> None:
    url = server["also"]["tiny"]
    with Client(f"tiny+{url}") as policy:
        for _ in range(2):
            policy.reset()
            first = [policy.infer(observation(0.25))[0]["arm_joint_state"] for _ in range(2)]
            np.testing.assert_allclose(first, [[count, *[0.25] * 6] for count in (1, 2)])
        with pytest.raises(PolicyServerError, match="the gripper is unhappy"):
            policy.infer(observation(0.25, instruction="fall over"))
        with pytest.raises(PolicyServerError, match="KeyError"):
            policy.infer({"state": {}})
        assert policy.infer(observation(0.25))[0]["arm_joint_state"][0] == 3
    with Client(url, config={"wire": "tiny", "server": url}) as policy:
        assert policy.infer(observation(0.5))[1]["arm_joint_state"][1] == 0.5


# -- a rule ------------------------------------------------------------------------------------------------------------


def test_a_rule_of_a_package_is_listed_explained_and_run(xpl: Run, write_adapter: Callable[..., Path]) -> None:
    listed = json.loads(xpl("rules", "--json").stdout)["rules"]
    assert [(rule["slug"], rule["gate"]) for rule in listed if rule["code"] == "TINY101"] == [
        ("names-a-maintainer", "static")
    ]
    assert "A user who finds a fault cannot report it." in xpl("explain", "tiny101").stdout
    folder = write_adapter("")
    (folder / "README.md").write_text("# Subject\n")
    chosen = ("--gate", "static", "--select", "TINY", "--fail-on", "warn", "--format", "json")
    report = json.loads(xpl("audit", folder, *chosen, code=1).stdout)
    assert validate(report, "audit") == []
    (result,) = (one for one in report["targets"][0]["gates"][0]["results"] if one["findings"])
    assert (result["code"], Path(result["findings"][0]["path"]).name) == ("TINY101", "README.md")
    (folder / "README.md").write_text("Maintainer: Ada Example\n")
    xpl("audit", folder, *chosen)


def test_a_rule_of_a_package_changes_no_digest(xpl: Run, write_adapter: Callable[..., Path]) -> None:
    """Others need not have it."""
    folder = write_adapter("")
    (folder / "README.md").write_text("# Subject\n")
    chosen = ("--gate", "static", "--select", "XPL10", "--format", "json")
    reports = [json.loads(xpl("audit", folder, *chosen, *more, code=1).stdout) for more in ((), ("--select", "TINY"))]
    digests = [one["targets"][0]["gates"][0]["digest"] for one in reports]
    assert digests[0] == digests[1] is not None


# -- a robot, and an environment ---------------------------------------------------------------------------------------


def test_a_robot_of_a_package_is_shown_and_scaffolded_and_its_environment_played(
    site: Path, xpl: Run, tmp_path: Path
) -> None:
    """By name, in an empty folder: the policy gets the robot, and so does the environment's process."""
    assert "of xpl-tiny 1.0" in xpl("spec", "show").stdout
    assert "hold_still" in xpl("env", "list", "tiny_desk", "--json").stdout
    report = json.loads(xpl("audit", "tiny_desk", "--gate", "static", "--format", "json").stdout)
    assert report["targets"][0]["kind"] == "env"
    assert get_embodiment("tiny_arm").arms[0].dof == 2
    xpl("new-policy", "Desk", "--embodiment", "tiny_arm", "--action-type", "joint")
    played = ["eval", "policy/Desk", "--env", "tiny_desk", "--episodes", "1", "--out", "run"]
    environment = {**os.environ, "PYTHONPATH": f"{site}:{REPO}"}
    subprocess.run([sys.executable, "-m", "xpl_cli", *played], cwd=tmp_path, env=environment, check=True)
    lines = (tmp_path / "run" / "records.jsonl").read_text().splitlines()
    assert any('"tiny_arm"' in line for line in lines)


# -- formats -----------------------------------------------------------------------------------------------------------


def test_a_report_format_of_a_package_is_written(xpl: Run, write_adapter: Callable[..., Path], tmp_path: Path) -> None:
    folder = write_adapter("")
    (folder / "README.md").write_text("# Subject\n")
    chosen = ("--gate", "static", "--select", "TINY", "--fail-on", "warn")
    table = xpl("audit", folder, *chosen, "--format", "csv", "--output", "csv=found.csv", code=1).stdout
    head, line = csv.reader(table.splitlines())
    assert head == ["rule", "outcome", "file", "line", "message"]
    assert (line[:2], Path(line[2]).name) == (["TINY101", "warn"], "README.md")
    assert (tmp_path / "found.csv").read_text() == table
    assert "did you mean csv?" in xpl("audit", folder, "--format", "cvs", code=2).stderr


def test_demonstrations_in_a_format_of_a_package_are_listed_and_converted(xpl: Run, tmp_path: Path) -> None:
    (tmp_path / "demos").mkdir()
    draw = np.random.default_rng(0)
    action = draw.normal(size=(6, 7)).astype(np.float32)
    top = draw.integers(0, 255, (6, 32, 32, 3), np.uint8)
    np.savez(tmp_path / "demos" / "one.npz", action=action, top=top)
    listing = json.loads(xpl("data", "list", "demos", "--json").stdout)
    assert (listing["format"], listing["columns"]["action"]["shape"]) == ("npz", [7])
    xpl("data", "convert", "demos", "made", "--to", "lerobot-v3.0", "--rate", "25", "--images", "png")
    episode = open_set(tmp_path / "made")[0]
    np.testing.assert_array_equal(episode.read("action"), action)
    np.testing.assert_array_equal(list(episode.frames("observation.images.top")), top)
