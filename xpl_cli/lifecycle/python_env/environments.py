"""Installed environments: each has a folder of its own, and a link points to the one in use.

An environment cannot be moved: its scripts contain its path. So a new one is created in its final folder, and only the
link changes, atomically. Processes in the old one continue.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import json
import os
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from xpl import json_text
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle.python_env import installers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.lifecycle.python_env.plan import EnvironmentPlan

RECORD = "xpl-environment.json"
"""Record of an environment's sources and packages; written last, so that an environment without it is incomplete."""
SCHEMA = "xpl.environment/1"

Condition = Literal["current", "outdated", "missing", "foreign"]


@dataclass(frozen=True)
class InstalledEnvironment:
    """An environment in use.

    Attributes:
        python: its interpreter.
        state: "made", "replaced", "unchanged" or "given".
        record: its sources and packages; empty for an environment that xpl did not create.
    """

    python: Path
    state: str
    record: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Folder of the environment."""
        return self.python.parents[1]


def condition(plan: EnvironmentPlan) -> Condition:
    """Return the state of an environment: current, outdated, missing, or foreign (not created by xpl)."""
    if not os.path.lexists(plan.link):
        return "missing"
    if not plan.link.is_symlink():
        return "foreign"
    record = read_record(plan.link)
    if record is None or not (plan.link / "bin" / "python").exists():
        return "missing"
    return "current" if record.get("key") == plan.key() else "outdated"


def read_record(folder: Path) -> dict[str, Any] | None:
    """Return the record of an environment, None without one."""
    try:
        record: dict[str, Any] = json_text.parse((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record


def install(plan: EnvironmentPlan, *, force: bool = False) -> InstalledEnvironment:
    """Create the environment of a plan unless it is current, and put it in use.

    Args:
        plan: the declared environment.
        force: create it again.

    Raises:
        UserError: if it cannot be created; the former one stays in use.
    """
    key = plan.key()
    _make(plan.link.parent)
    with _exclusive_lock(plan.link.parent):
        before = condition(plan)
        if before == "foreign":
            raise UserError(
                f"{plan.link} exists, and `xpl install` did not create it: it is kept",
                hint="move it away, or choose another `name` in `environment`",
            )
        if before == "current" and not force:
            return _installed(plan, "unchanged")
        _prune(plan)
        folder = _unused_folder(plan, key)
        try:
            installed = installers.build(plan, folder)
            (folder / ".gitignore").write_text("*\n", encoding="utf-8")
            record = {
                "schema": SCHEMA,
                "key": key,
                "manager": plan.manager,
                "wanted_python": plan.python,
                "lock": None if plan.lock is None else plan.lock.relative_to(plan.base).as_posix(),
                "requirements": list(plan.requirements),
                **installed,
            }
            atomic.write_file(folder / RECORD, (json.dumps(record, indent=2) + "\n").encode())
            _switch_link(plan.link, folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        _prune(plan)
        return _installed(plan, "made" if before == "missing" else "replaced")


def _installed(plan: EnvironmentPlan, state: str) -> InstalledEnvironment:
    folder = plan.link.resolve()
    return InstalledEnvironment(folder / "bin" / "python", state, read_record(folder) or {})


@contextlib.contextmanager
def _exclusive_lock(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock on a folder for a `with` block; it ends with the process at the latest."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _switch_link(link: Path, folder: Path) -> None:
    """Point a link to a folder beside it, atomically."""
    with tempfile.TemporaryDirectory(dir=link.parent, prefix=f".{link.name.lstrip('.')}-") as scratch:
        fresh = Path(scratch) / link.name
        fresh.symlink_to(folder.name)  # relative, so that it can be read
        fresh.replace(link)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{folder} cannot be created: {error.strerror}", code=ExitCode.NOT_RUN) from None


def _unused_folder(plan: EnvironmentPlan, key: str) -> Path:
    """Return an unused folder for a new environment."""
    plain = plan.link.with_name(f"{plan.link.name}-{key}")
    others = (plain.with_name(f"{plain.name}.{number}") for number in itertools.count(1))
    return next(path for path in itertools.chain([plain], others) if not os.path.lexists(path))


def _prune(plan: EnvironmentPlan) -> None:
    """Remove unused environments: replaced and incomplete ones."""
    ours = re.compile(rf"{re.escape(plan.link.name)}-[0-9a-f]{{12}}(\.\d+)?")
    used = plan.link.resolve() if plan.link.is_symlink() else None
    if not plan.link.parent.is_dir():
        return
    for path in plan.link.parent.iterdir():
        if ours.fullmatch(path.name) and path.is_dir() and not path.is_symlink() and path.resolve() != used:
            if _runs_from(path.resolve()):
                continue
            shutil.rmtree(path, ignore_errors=True)


def _runs_from(folder: Path) -> bool:
    """Tell whether a process runs the interpreter of an environment, as far as /proc shows it."""
    start = os.fsencode(folder / "bin") + b"/"
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if entry.read_bytes().startswith(start):
                return True
    return False
