"""Shared by the commands that scaffold a package: write it or list the changes, and report them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from xpl_cli.scaffold.template import Files

_SENTENCE = {
    "written": "{count} files written",
    "replaced": "replaced by {count} files of the template",
    "unchanged": "already there, unchanged",
    "would be written": "{count} files would be written",
    "would be replaced": "{count} files would replace what is there (needs --overwrite)",
    "would be unchanged": "already there, would stay unchanged",
}


def put(files: Files, target: Path, *, overwrite: bool, dry_run: bool) -> str:
    """Write a rendered template, or with `dry_run` only compute the changes; return them."""
    from xpl_cli.scaffold import adapter

    return _preview(files, target) if dry_run else adapter.write(files, target, overwrite=overwrite)


def report(
    files: Files,
    target: Path,
    state: str,
    following: list[str],
    *,
    schema: str,
    as_json: bool,
    facts: Mapping[str, Any] | None = None,
    lines: Sequence[str] = (),
) -> None:
    """Print the changes and the next commands.

    Args:
        files: the package.
        target: where it is.
        state: what became of it.
        following: the commands.
        schema: of the JSON object.
        as_json: print that.
        facts: what more the object says.
        lines: what more is said to people.
    """
    from xpl_cli.basics import console
    from xpl_cli.scaffold import adapter

    open_places = adapter.placeholders(files)
    if as_json:
        answer = {
            "path": str(target),
            "state": state,
            "files": list(files),
            "placeholders": [vars(place) for place in open_places],
            **(facts or {}),
        }
        console.answer(schema, answer, following)
        return
    console.data(f"{target}: {_SENTENCE[state].format(count=len(files))}, {len(open_places)} places to fill in")
    for line in lines:
        console.data(line)
    for command in following:
        console.data(f"next: {command}")


def _preview(files: Files, target: Path) -> str:
    from xpl_cli.basics import console
    from xpl_cli.scaffold import adapter

    changed = adapter.differences(files, target)
    for file in changed:
        console.note(f"{'~' if (target / file).exists() else '+'} {target / file}")
    if not changed:
        return "would be unchanged"
    return "would be replaced" if target.exists() and any(target.iterdir()) else "would be written"
