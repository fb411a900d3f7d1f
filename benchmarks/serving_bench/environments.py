"""The contenders' own environments, each made from its lock file on first use and kept beside this folder."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
LOCKS = HERE / "locks"
PEERS = HERE.parent / ".peers"
BUILD_S = 600.0


class BuildError(RuntimeError):
    """An environment cannot be made; the text is why."""


def python_of(lock: str | None, locks: Path = LOCKS) -> str:
    """Return the interpreter of a contender, making its environment if there is none of exactly this lock file.

    Args:
        lock: name of a lock file without its ending, or None for this environment.
        locks: folder of the lock files.

    Raises:
        BuildError: if it cannot be made.
    """
    if lock is None:
        return sys.executable
    requirements = locks / f"{lock}.txt"
    digest = hashlib.sha256(requirements.read_bytes() + sys.version.encode()).hexdigest()[:12]
    folder = PEERS / f"{lock}-{digest}"
    python = folder / "bin" / "python"
    complete = folder / ".complete"
    if not complete.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        if uv := shutil.which("uv") or shutil.which("uv", path=Path(sys.executable).parent):
            _run([uv, "venv", "--quiet", "--python", sys.executable, str(folder)])
            _run([uv, "pip", "install", "--quiet", "--python", str(python), "-r", str(requirements)])
        else:
            _run([sys.executable, "-m", "venv", str(folder)])
            _run([str(python), "-m", "pip", "install", "--quiet", "-r", str(requirements)])
        complete.touch()
    return str(python)


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(
            command, check=False, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=BUILD_S
        )
    except subprocess.TimeoutExpired:
        raise BuildError(f"{command[0]} took longer than {BUILD_S:g} s") from None
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines()
        raise BuildError(lines[-1].strip() if lines else f"{command[0]} failed")
