"""Environment packages over a benchmark's own code: their Pythons, programs that run there, and common checks."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.interop import build
from tests.support.peer import xpl
from xpl import rotation
from xpl_cli.basics.errors import ExitCode
from xpl_cli.packages import environments

FOLDER = Path(__file__).resolve().parent
LIMIT_S = 1700.0
patient = pytest.mark.timeout(LIMIT_S + 60)
"""The mark of modules whose first test makes all observations: a minute of an idle core, half an hour of a busy one."""
NO_VULKAN = "not run: there is no Vulkan device; envs/maniskill/mesa.sh gets a driver"


class Benchmark:
    """An environment package, whose simulator runs in a Python of its own.

    Args:
        name: the package.

    Attributes:
        env: its folder.
        manifest: its env.yml.
        robots: its embodiments.
        python: the interpreter that has its simulator; None if it is not installed.
        needed: the mark of tests that run it.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.env = build.ROOT / "envs" / name
        self.manifest = environments.manifest(self.env).data
        self.robots = self.manifest["embodiments"]
        self.python = build.interpreter(name, locks=self.env)
        reason = f"not run: {name} is not installed from envs/{name}/{name}.lock.txt; `./dev peers` does so"
        self.needed = pytest.mark.skipif(self.python is None, reason=reason)

    def look(self, *parts: str) -> Any:
        """Return what parts of `look_at_NAME.py` print, run in the benchmark's Python."""
        command = [str(self.python), str(FOLDER / f"look_at_{self.name}.py"), *parts]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT_S)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    def play(self, policy: str, *options: str) -> dict[str, Any]:
        """Return the report of an evaluation over the wire."""
        assert self.python is not None
        place = ("--env", str(self.env), "--eval-env", f"venv:{self.python.parents[1]}")
        done = xpl("eval", str(build.ROOT / "policy" / policy), *place, *options, "--json", cwd=build.ROOT)
        assert done.returncode == ExitCode.CLEAN, done.stderr
        report: dict[str, Any] = json.loads(done.stdout)
        return report

    def solve(self, *options: str) -> None:
        """Check that the benchmark's own expert solves both episodes of an evaluation over the wire."""
        report = self.play("benchmark_expert", "--episodes", "2", *options)
        assert report["success_rate"] == 1.0, report

    def audit(self, folder: Path, **settings: str) -> None:
        """Check that every rule for environments holds, without pictures, which a machine may not draw."""
        chosen = [f"--set={name}={value}" for name, value in {"cameras": "false", **settings}.items()]
        done = xpl("audit", str(self.env), "--python", str(self.python), *chosen, "--no-cache", "--json", cwd=folder)
        assert done.returncode == ExitCode.CLEAN, json.loads(done.stdout)


def move_along_axes(distances: dict[str, list[float]], far: float, within: float) -> bool:
    """Return whether the tool moved along each axis of the world, both ways, by the commanded distance, m."""
    ways = {"+": far, "-": -far}
    expected = {sign + "xyz"[axis]: way * np.eye(3)[axis] for sign, way in ways.items() for axis in range(3)}
    assert distances.keys() == expected.keys()
    return all(np.abs(np.array(moved) - expected[way]).max() < within for way, moved in distances.items())


def same_pose(one: Any, other: Any, metres: float = 1e-3, radians: float = 1e-3) -> bool:
    """Return whether two poses (7,) are equal within a tolerance."""
    one, other = np.asarray(one), np.asarray(other)
    return bool(np.abs(one[:3] - other[:3]).max() < metres and rotation.angle_between(one[3:], other[3:]) < radians)


def is_colored(color: list[float], channel: int) -> bool:
    """Return whether one channel of a color (R, G, B) dominates the others."""
    return color[channel] > 3 * max(*color[:channel], *color[channel + 1 :], 1)
