"""The project that an agent works in, under one condition, and what was seen of its work there."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from benchmarks.skills_bench import witness

if TYPE_CHECKING:
    from benchmarks.skills_bench.cases import Task

CONDITIONS: Final = ("none", "docs", "skills")
"""Only the command `xpl`; also the documentation; also the skills, as `xpl skills install` installs them."""
MAKE: Final = "make.py"
"""Script that writes files of a task that are no text, such as weights; removed before the agent begins."""


class SetupError(Exception):
    """A project cannot be made."""


@dataclass(frozen=True)
class Project:
    """A folder with the files of a task.

    Attributes:
        folder: where the agent works.
        given: digests of all files at the beginning.
        environment: variables of the agent's processes.
        log: written by the witness.
    """

    folder: Path
    given: dict[str, str]
    environment: dict[str, str]
    log: Path

    def calls(self) -> list[dict[str, Any]]:
        """Return the commands of `xpl` that were run, from the witness's log."""
        return [json.loads(line) for line in self.log.read_text(encoding="utf-8").splitlines()]

    def changed(self, below: str = "") -> list[str]:
        """Return files that are not what they were, or were not there; caches of Python do not count."""
        now = digests(self.folder)
        names = sorted(name for name in now.keys() | self.given.keys() if name.startswith(below))
        return [name for name in names if now.get(name) != self.given.get(name)]


@contextmanager
def project(task: Task, condition: str) -> Iterator[Project]:
    """Make a project for a task; it is removed afterwards.

    Raises:
        SetupError: a command of its set-up fails.
    """
    with TemporaryDirectory(prefix="xpl-skills-") as top:
        folder = Path(top) / "project"
        folder.mkdir()
        environment = _environment(Path(top), condition)
        _run(["git", "init", "--quiet"], folder, environment)  # agents look for the top of a work tree
        for command in task.setup:
            _run([sys.executable, "-m", "xpl_cli", *shlex.split(command)[1:]], folder, environment)
        if task.files.is_dir():
            shutil.copytree(task.files, folder, dirs_exist_ok=True)
        if (folder / MAKE).exists():
            _run([sys.executable, MAKE], folder, environment)
            (folder / MAKE).unlink()
        _equip(folder, condition, environment)
        log = Path(environment[witness.LOG])
        log.touch()
        yield Project(folder, digests(folder), environment, log)


def digests(folder: Path) -> dict[str, str]:
    """Return the digest of every file below a folder, by its path."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not {"__pycache__", ".git"} & set(path.parts)
    }


def _environment(top: Path, condition: str) -> dict[str, str]:
    programs = top / "bin"
    programs.mkdir()
    program = programs / "xpl"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{witness.__file__}" "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return {
        **os.environ,
        "PATH": os.pathsep.join([str(programs), str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
        "PYTHONDONTWRITEBYTECODE": "1",
        witness.LOG: str(top / "calls.jsonl"),
        witness.HIDES: "" if condition == "skills" else "skills",
    }


def _equip(folder: Path, condition: str, environment: dict[str, str]) -> None:
    if condition == "skills":
        _run([sys.executable, "-m", "xpl_cli", "skills", "install"], folder, environment)
    elif condition == "docs":
        # Text about skills would provide the skills in another way.
        shutil.copytree(witness.ROOT / "docs", folder / "docs", ignore=shutil.ignore_patterns("skills.md", "*.png"))
        shutil.copy(witness.ROOT / "README.md", folder / "docs" / "README.md")


def _run(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=witness.environment(environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
    except FileNotFoundError:
        raise SetupError(f"there is no program {command[0]!r} on PATH") from None
    if done.returncode:
        raise SetupError(f"{shlex.join(command[1:])} ended with {done.returncode}: {done.stderr.strip()[-300:]}")
