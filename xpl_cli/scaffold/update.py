"""Update of a package to the current template, with the author's changes kept.

`.xpl/` records the answers and the rendered files. The template is rendered again with these answers, and the
difference between the two renders is merged into the author's files.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError, one_of
from xpl_cli.packages import package
from xpl_cli.scaffold import adapter, environment, lock, merge
from xpl_cli.standard.schemas import FOLDER

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from xpl_cli.scaffold.template import Files

Action = Literal["added", "updated", "merged", "removed", "conflict", "kept"]

_LABELS = merge.ConflictLabels("yours", "as rendered", "template")
_SCRIPT, _PLAIN = 0o755, 0o644


@dataclass(frozen=True)
class FileUpdate:
    """The update of one file.

    Attributes:
        name: the file.
        action: `added`, `updated` (without changes by the author), `merged`, `removed`, `conflict`, or `kept` where the
            template changed and the file is left unchanged.
        before, after: its content; None for no file.
        conflicts: number of conflicts.
        note: for the author.
    """

    name: str
    action: Action
    before: bytes | None
    after: bytes | None
    conflicts: int = 0
    note: str | None = None


@dataclass(frozen=True)
class UpdatePlan:
    """The update of a package; `steps` omits files that do not change."""

    folder: Path
    steps: tuple[FileUpdate, ...]

    @property
    def conflicts(self) -> tuple[FileUpdate, ...]:
        """The files with conflicts."""
        return tuple(step for step in self.steps if step.action == "conflict")

    @property
    def changes(self) -> tuple[FileUpdate, ...]:
        """The files that are written or removed."""
        return tuple(step for step in self.steps if step.before != step.after)


def plan(folder: Path) -> UpdatePlan:
    """Plan the update of a package to the current template. Nothing is written.

    Raises:
        UserError: the package has no record of its template.
    """
    package_lock = lock.read(folder)
    if package_lock is None:
        raise UserError(
            f"{folder} has no {lock.PATH}: its template is unknown",
            hint="only packages of `xpl new-policy` and `xpl new-env` can be updated",
        )
    base = lock.read_rendered(folder)
    theirs = _render_current(package_lock)
    steps = [
        _file(folder, name, base.get(name), theirs.get(name)) for name in _merged_names(package_lock, base, theirs)
    ]
    updates = [step for step in steps if step is not None]
    return UpdatePlan(folder, (*updates, *_bookkeeping_updates(folder, package_lock, base, theirs)))


def apply(plan: UpdatePlan) -> None:
    """Apply a plan completely or not at all.

    Raises:
        UserError: a file changed meanwhile, or cannot be written; then all files are restored.
    """
    for step in plan.changes:
        if _content(plan.folder / step.name) != step.before:
            raise UserError(f"{plan.folder / step.name} changed meanwhile: nothing was written", hint="run again")
    modes = {step.name: _mode(plan.folder / step.name) for step in plan.changes}
    applied: list[FileUpdate] = []
    try:
        for step in plan.changes:
            _write_content(plan.folder / step.name, step.after, modes[step.name])
            applied.append(step)
    except BaseException as error:
        for step in applied:
            _write_content(plan.folder / step.name, step.before, modes[step.name])
        if not isinstance(error, OSError):
            raise
        raise UserError(
            f"{plan.folder} cannot be written: {error.strerror or error} ({error.filename}); nothing was changed"
        ) from None


def _render_current(package_lock: lock.Lock) -> Files:
    """Render the current template with the recorded answers; newer questions have their defaults."""
    one_of("template", package_lock.template, (package.POLICY, package.ENV))
    if package_lock.template == package.ENV:
        return environment.render_env(environment.recorded_env_answers(package_lock))
    return adapter.render(adapter.recorded_answers(package_lock))


def _merged_names(package_lock: lock.Lock, base: Files, theirs: Files) -> list[str]:
    names = {*base, *theirs} - set(package_lock.free)
    return sorted(name for name in names if not name.startswith(f"{FOLDER}/"))


def _file(folder: Path, name: str, base: bytes | None, theirs: bytes | None) -> FileUpdate | None:
    """Return the update of a file; None if it does not change."""
    path = folder / name
    ours = _content(path)
    if theirs in (base, ours):
        return None
    if path.is_symlink() or (path.exists() and not path.is_file()):
        return FileUpdate(name, "kept", None, None, note="it is a link or a folder: left unchanged")
    if ours == base:
        return FileUpdate(name, "added" if ours is None else "removed" if theirs is None else "updated", ours, theirs)
    if ours is None:
        return FileUpdate(name, "kept", None, None, note="you removed it, and the template changed it: not written")
    if theirs is None:
        return FileUpdate(name, "kept", ours, ours, note="the template no longer has it: it is yours now")
    merged = merge.merge(base or b"", ours, theirs, _LABELS)
    return FileUpdate(name, "conflict" if merged.conflicts else "merged", ours, merged.content, merged.conflicts)


def _bookkeeping_updates(folder: Path, package_lock: lock.Lock, base: Files, theirs: Files) -> Iterator[FileUpdate]:
    """Yield the updates of the files below `.xpl/`.

    Lockfile and rendered files come last, so that an interrupted update starts again from the old record.
    """
    new = lock.parse(theirs[lock.PATH], lock.PATH)
    generated = {name: value for name, value in new.generated.items() if name not in package_lock.free}
    texts = lock.parse_rendered(theirs[lock.RENDERED])
    taken_over = {name: base[name] for name in package_lock.free if name in base}
    files = {name: content for name, content in theirs.items() if name.startswith(f"{FOLDER}/")}
    files[lock.PATH] = replace(new, generated=generated, free=package_lock.free).text().encode()
    files[lock.RENDERED] = lock.rendered_text({**texts, **taken_over})
    for name in sorted(files, key=lambda name: (name in (lock.PATH, lock.RENDERED), name)):
        before = _content(folder / name)
        if before != files[name]:
            yield FileUpdate(name, "added" if before is None else "updated", before, files[name])


def _write_content(path: Path, content: bytes | None, mode: int | None = None) -> None:
    if content is None:
        path.unlink(missing_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic.write_file(path, content, mode or (_SCRIPT if path.suffix == ".sh" else _PLAIN))


def _mode(path: Path) -> int | None:
    return path.stat().st_mode & 0o7777 if path.is_file() else None


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None
