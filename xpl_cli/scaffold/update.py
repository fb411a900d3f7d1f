"""Brings a package to what its template is today, and keeps what its author made of it.

`.xpl/` keeps the answers that the package was rendered by, and what came out. The template is rendered again with these
answers; the difference between the two renders is what the author's files get.
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

_LABELS = merge.Labels("yours", "as rendered", "template")
_SCRIPT, _PLAIN = 0o755, 0o644


@dataclass(frozen=True)
class Step:
    """What an update does to one file.

    Attributes:
        name: the file.
        action: `added`, `updated` (the author had not touched it), `merged`, `removed`, `conflict`, or `kept` where the
            template changed and the file was left alone.
        before, after: its content, None for none.
        conflicts: places that the author has to decide.
        note: what the author should know.
    """

    name: str
    action: Action
    before: bytes | None
    after: bytes | None
    conflicts: int = 0
    note: str | None = None


@dataclass(frozen=True)
class Plan:
    """What an update does to a package; `steps` leaves out files that stay as they are."""

    folder: Path
    steps: tuple[Step, ...]

    @property
    def conflicts(self) -> tuple[Step, ...]:
        """The steps that leave something to decide."""
        return tuple(step for step in self.steps if step.action == "conflict")

    @property
    def changes(self) -> tuple[Step, ...]:
        """The steps that write or remove a file."""
        return tuple(step for step in self.steps if step.before != step.after)


def plan(folder: Path) -> Plan:
    """Return what it takes to bring a package to today's template. Nothing is written.

    Raises:
        UserError: if the package does not tell what it came from.
    """
    kept = lock.read(folder)
    if kept is None:
        raise UserError(
            f"{folder} has no {lock.PATH}: nothing tells which template it came from",
            hint="only what `xpl new-policy` and `xpl new-env` wrote can be updated",
        )
    base = lock.read_rendered(folder)
    theirs = _rendered(kept)
    steps = [_file(folder, name, base.get(name), theirs.get(name)) for name in _merged_names(kept, base, theirs)]
    found = [step for step in steps if step is not None]
    return Plan(folder, (*found, *_own(folder, kept, base, theirs)))


def apply(plan: Plan) -> None:
    """Write what a plan says, all of it or nothing.

    Raises:
        UserError: if a file changed since, or cannot be written; then all are as they were.
    """
    for step in plan.changes:
        if _content(plan.folder / step.name) != step.before:
            raise UserError(f"{plan.folder / step.name} changed meanwhile: nothing was written", hint="run again")
    modes = {step.name: _mode(plan.folder / step.name) for step in plan.changes}
    done: list[Step] = []
    try:
        for step in plan.changes:
            _put(plan.folder / step.name, step.after, modes[step.name])
            done.append(step)
    except BaseException as error:
        for step in done:
            _put(plan.folder / step.name, step.before, modes[step.name])
        if not isinstance(error, OSError):
            raise
        raise UserError(
            f"{plan.folder} cannot be written: {error.strerror or error} ({error.filename}); nothing was changed"
        ) from None


def _rendered(kept: lock.Lock) -> Files:
    """Render what the package would come from now; what its template did not ask then has the default."""
    one_of("template", kept.template, (package.POLICY, package.ENV))
    if kept.template == package.ENV:
        return environment.render_env(environment.recorded_env(kept))
    return adapter.render(adapter.recorded(kept))


def _merged_names(kept: lock.Lock, base: Files, theirs: Files) -> list[str]:
    names = {*base, *theirs} - set(kept.free)
    return sorted(name for name in names if not name.startswith(f"{FOLDER}/"))


def _file(folder: Path, name: str, base: bytes | None, theirs: bytes | None) -> Step | None:
    """Return the step for a file, None where it stays as it is."""
    path = folder / name
    ours = _content(path)
    if theirs in (base, ours):
        return None
    if path.is_symlink() or (path.exists() and not path.is_file()):
        return Step(name, "kept", None, None, note="it is a link or a folder: left alone")
    if ours == base:
        return Step(name, "added" if ours is None else "removed" if theirs is None else "updated", ours, theirs)
    if ours is None:
        return Step(name, "kept", None, None, note="you removed it, and the template changed it: left out")
    if theirs is None:
        return Step(name, "kept", ours, ours, note="the template has it no more: it is yours now")
    merged = merge.merge(base or b"", ours, theirs, _LABELS)
    return Step(name, "conflict" if merged.conflicts else "merged", ours, merged.content, merged.conflicts)


def _own(folder: Path, kept: lock.Lock, base: Files, theirs: Files) -> Iterator[Step]:
    """Yield the steps for what xpl keeps in the package.

    The record of the render comes last: an update that was cut off is begun again from where it was.
    """
    new = lock.parse(theirs[lock.PATH], lock.PATH)
    generated = {name: value for name, value in new.generated.items() if name not in kept.free}
    texts = lock.parse_rendered(theirs[lock.RENDERED])
    taken_over = {name: base[name] for name in kept.free if name in base}
    files = {name: content for name, content in theirs.items() if name.startswith(f"{FOLDER}/")}
    files[lock.PATH] = replace(new, generated=generated, free=kept.free).text().encode()
    files[lock.RENDERED] = lock.rendered_text({**texts, **taken_over})
    for name in sorted(files, key=lambda name: (name in (lock.PATH, lock.RENDERED), name)):
        before = _content(folder / name)
        if before != files[name]:
            yield Step(name, "added" if before is None else "updated", before, files[name])


def _put(path: Path, content: bytes | None, mode: int | None = None) -> None:
    if content is None:
        path.unlink(missing_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic.write_file(path, content, mode or (_SCRIPT if path.suffix == ".sh" else _PLAIN))


def _mode(path: Path) -> int | None:
    return path.stat().st_mode & 0o7777 if path.is_file() else None


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None
