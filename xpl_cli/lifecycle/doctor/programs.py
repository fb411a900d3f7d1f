"""Probes that run a program: interpreters, installers, git, containers, the graphics card, rendering."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from xpl_cli.lifecycle.doctor.check import MachineCheck, Status
from xpl_cli.lifecycle.python_env import installers, pythons

LIMIT_S = 5.0
"""Longest wait for a program."""

_SHOWN = 110
_GPU_ASKED = "name,memory.total,driver_version"
_VERSION = re.compile(r"\d+(\.\d+)+")


@dataclass(frozen=True)
class ProgramOutput:
    """Output of a program.

    Attributes:
        ok: whether it ran and ended with 0.
        text: its output, or its last line of error output.
    """

    ok: bool
    text: str


def run_program(*command: str) -> ProgramOutput:
    """Run a program and return its output."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False, timeout=LIMIT_S,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return ProgramOutput(ok=False, text=f"no answer within {LIMIT_S:.0f} s")
    except OSError as error:
        return ProgramOutput(ok=False, text=error.strerror or str(error))
    if done.returncode == 0:
        return ProgramOutput(ok=True, text=done.stdout.strip())
    reason = f"ended by signal {-done.returncode}" if done.returncode < 0 else f"exit code {done.returncode}"
    return ProgramOutput(ok=False, text=(done.stderr.strip().splitlines() or [reason])[-1])


def interpreters() -> MachineCheck:
    """Find the versions of Python that can create environments for policies."""
    paths = [path for name in pythons.names() if (path := shutil.which(name))]
    with ThreadPoolExecutor(max_workers=max(len(paths), 1)) as pool:
        versions = [version for version in pool.map(pythons.version_of, paths) if version]
    own = sys.version_info
    text = ", ".join(versions) or "none but the tool's own"
    return MachineCheck(
        "python",
        Status.OK if versions else Status.ABSENT,
        f"{text}; this tool runs in {own.major}.{own.minor}.{own.micro}",
        "environments of policies that need another version",
        None if versions else "install python3.X with its venv module, or uv, which brings interpreters itself",
    )


def program(name: str, serves: str, fix: str, *others: str) -> MachineCheck:
    """Run a program for its version; `others` are alternative programs."""
    for candidate in (name, *others):
        path = shutil.which(candidate)
        if path is None:
            continue
        answer = run_program(path, "--version")
        version = _VERSION.search(answer.text) if answer.ok else None
        if answer.ok:
            return MachineCheck(name, Status.OK, f"{candidate} {version[0] if version else answer.text[:40]}", serves)
        return MachineCheck(name, Status.BROKEN, f"{path} does not run: {answer.text[:_SHOWN]}", serves, fix)
    return MachineCheck(name, Status.ABSENT, "not on PATH", serves, fix)


def uv() -> MachineCheck:
    """Check uv."""
    serves = "installs environments quickly, any version of Python, locks of uv; venv and pip do where it is missing"
    return program("uv", serves, "pip install uv, or see its installation page")


def conda() -> MachineCheck:
    """Check conda, mamba or micromamba."""
    name, *others = installers.CONDAS
    return program(name, "environments that come as a lock of conda", "install miniforge or micromamba", *others)


def git() -> MachineCheck:
    """Check git."""
    return program("git", "xpl update and xpl audit --changed-since", "apt-get install git")


def docker() -> MachineCheck:
    """Check for a program that builds containers."""
    return program("docker", "the container recipe (docs/lifecycle.md)", "install docker or podman", "podman")


def gpu() -> MachineCheck:
    """List graphics cards by the driver, without machine learning libraries."""
    serves = "policies that run on a graphics card"
    devices = sorted(path.name for path in Path("/dev").glob("nvidia[0-9]*"))
    tool = shutil.which("nvidia-smi")
    if tool is None:
        if devices:
            return MachineCheck("gpu", Status.BROKEN, f"{', '.join(devices)}, but no nvidia-smi on PATH", serves,
                         "install the driver's utilities, or give the container the NVIDIA runtime")  # fmt: skip
        return MachineCheck(
            "gpu", Status.ABSENT, "no NVIDIA device", serves, "use a machine with one, if a policy needs it"
        )
    answer = run_program(tool, f"--query-gpu={_GPU_ASKED}", "--format=csv,noheader")
    cards = [line.strip() for line in answer.text.splitlines() if line.strip()] if answer.ok else []
    if cards:
        return MachineCheck("gpu", Status.OK, "; ".join(cards), serves)
    reason = answer.text.splitlines()[0][:_SHOWN] if answer.text else "it lists no card"
    return MachineCheck("gpu", Status.BROKEN if devices else Status.ABSENT, f"nvidia-smi: {reason}", serves,
                 "check the driver (nvidia-smi), or the devices that the container was given")  # fmt: skip


def rendering(way: str) -> MachineCheck:
    """Test one way of offscreen rendering: `egl` or `osmesa`."""
    answer = run_program(sys.executable, "-I", "-S", str(Path(__file__).with_name("graphics.py")), way)
    serves = f"simulators that render with MUJOCO_GL={way}; envs/mujoco renders without"
    if answer.ok:
        return MachineCheck(way, Status.OK, answer.text, serves)
    package = {"egl": "libegl1 (and the driver of the card, or libgl1-mesa-dri)", "osmesa": "libosmesa6"}[way]
    missing = "cannot open shared object" in answer.text
    return MachineCheck(
        way,
        Status.ABSENT if missing else Status.BROKEN,
        answer.text[:_SHOWN],
        serves,
        f"apt-get install {package}",
    )
