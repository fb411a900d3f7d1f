"""Where environments lie: each in a folder of its own for good, with a link to the one that is in use.

An environment cannot be moved: its scripts name the folder that they were made in. So a new one is made where it stays,
and what changes in one step is the link. Whoever runs in the old one goes on in it.
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
"""What an environment was made from, and what is in it; written last, so that one without it is not complete."""
SCHEMA = "xpl.environment/1"

Condition = Literal["current", "outdated", "missing", "foreign"]


@dataclass(frozen=True)
class InstalledEnvironment:
    """An environment that is in use.

    Attributes:
        python: its interpreter.
        state: "made", "replaced", "unchanged" or "given".
        record: what it was made from, and what is in it; empty for one that was given.
    """

    python: Path
    state: str
    record: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Where it lies."""
        return self.python.parents[1]


def condition(plan: EnvironmentPlan) -> Condition:
    """Return whether the environment of a plan is there: as declared now, as declared earlier, not, or not ours."""
    if not os.path.lexists(plan.link):
        return "missing"
    if not plan.link.is_symlink():
        return "foreign"
    record = read_record(plan.link)
    if record is None or not (plan.link / "bin" / "python").exists():
        return "missing"
    return "current" if record.get("key") == plan.key() else "outdated"


def read_record(folder: Path) -> dict[str, Any] | None:
    """Return what an environment was made from, None if nobody wrote that down."""
    try:
        record: dict[str, Any] = json_text.parse((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record


def install(plan: EnvironmentPlan, *, force: bool = False) -> InstalledEnvironment:
    """Make the environment of a plan unless it is there, and put it in use.

    Args:
        plan: what is declared.
        force: make it anew although it is there.

    Raises:
        UserError: if it cannot be made; what was in use before stays in use.
    """
    key = plan.key()
    _make(plan.link.parent)
    with _exclusive_lock(plan.link.parent):
        before = condition(plan)
        if before == "foreign":
            raise UserError(
                f"{plan.link} is there already, and `xpl install` did not make it: it stays as it is",
                hint="move it away, or choose another `name` in `environment`",
            )
        if before == "current" and not force:
            return _installed(plan, "unchanged")
        _prune(plan)
        folder = _unused_folder(plan, key)
        try:
            found = installers.build(plan, folder)
            (folder / ".gitignore").write_text("*\n", encoding="utf-8")
            record = {
                "schema": SCHEMA,
                "key": key,
                "manager": plan.manager,
                "wanted_python": plan.python,
                "lock": None if plan.lock is None else plan.lock.relative_to(plan.base).as_posix(),
                "requirements": list(plan.requirements),
                **found,
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
    """Let one process at a time make environments in a folder; the lock ends with it at the latest."""
    held = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield
    finally:
        os.close(held)


def _switch_link(link: Path, folder: Path) -> None:
    """Make a link lead to a folder beside it, in one step."""
    with tempfile.TemporaryDirectory(dir=link.parent, prefix=f".{link.name.lstrip('.')}-") as scratch:
        fresh = Path(scratch) / link.name
        fresh.symlink_to(folder.name)  # relative, so that it can be read
        fresh.replace(link)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{folder} cannot be made: {error.strerror}", code=ExitCode.NOT_RUN) from None


def _unused_folder(plan: EnvironmentPlan, key: str) -> Path:
    """Return a folder for an environment that is not there yet."""
    plain = plan.link.with_name(f"{plan.link.name}-{key}")
    others = (plain.with_name(f"{plain.name}.{number}") for number in itertools.count(1))
    return next(path for path in itertools.chain([plain], others) if not os.path.lexists(path))


def _prune(plan: EnvironmentPlan) -> None:
    """Remove environments that are not in use: what was replaced, and what somebody began and did not finish."""
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
    """Tell whether a process was started by the interpreter of an environment, as far as the system tells."""
    start = os.fsencode(folder / "bin") + b"/"
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if entry.read_bytes().startswith(start):
                return True
    return False
