"""XPL403: Robots, cameras and action types of env.yml are in the standard."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from difflib import get_close_matches

from xpl import _spec as sdk
from xpl import robots
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.source import Source

_NAME = "env.yml"


@rule(code="XPL403", gate="static", requirement="XPL-ENV-5")
def env_names(source: Source) -> Iterator[Finding]:
    """env.yml names a robot, a camera or an action type that is not in the standard.

    ## What it does
    Compares embodiments, cameras and action types with those of the standard, and checks that the stages of each task
    add up to a score of 1.

    ## Why it matters
    Policies request cameras and robots by these names. An environment that calls its camera `head_cam` provides, for
    every policy, no camera at all.

    ## Example
    `cameras: {head_cam: {}}`; the standard's name is cam_head.

    ## Use instead
    `xpl spec show embodiments` and `xpl spec show observation` list the names.

    ## Fix safety
    No automatic fix.
    """
    values = source.manifest_of(_NAME)
    cameras = {*sdk.OPTIONAL_CAMERAS, *(name for names in sdk.CAMERAS.values() for name in names)}
    for key, allowed, what in (
        ("embodiments", robots.names(), "robot"),
        ("cameras", cameras, "camera"),
        ("action_types", set(sdk.ACTION_TYPES), "kind of action"),
    ):
        yield from _unknown(source, key, values.get(key), allowed, what)
    tasks = values.get("tasks")
    for name, task in tasks.items() if isinstance(tasks, dict) else ():
        stages = task.get("stages") if isinstance(task, dict) else None
        parts = list(stages.values()) if isinstance(stages, dict) else []
        if parts and all(isinstance(part, (int, float)) for part in parts) and abs(sum(parts) - 1) > 1e-6:
            yield Finding(
                f"the stages of {name} add up to {sum(parts):g} and not 1: scores of tasks cannot be averaged",
                path=_NAME,
                line=_line(source, str(name)),
                column=1,
                expected="stages that add up to 1",
                got=f"{sum(parts):g}",
                fix=Fix("advice", "scale the stages"),
            )


def _unknown(source: Source, key: str, value: object, allowed: Collection[str], what: str) -> Iterator[Finding]:
    entries: Iterable[object] = value if isinstance(value, (list, dict)) else ()
    for entry in entries:
        if isinstance(entry, str) and entry not in allowed:
            near = get_close_matches(entry, allowed, n=1, cutoff=0.4)
            yield Finding(
                f"no policy finds the {what} {entry}: the standard has none of that name",
                path=_NAME,
                line=_line(source, entry, key),
                column=1,
                expected=", ".join(sorted(allowed)),
                got=entry,
                fix=Fix("advice", f"rename it{f' to {near[0]}' if near else ''}"),
            )


def _line(source: Source, *words: str) -> int:
    """Return the first line of env.yml that holds the first of these words that it holds at all."""
    lines = source.text(_NAME).split("\n")
    return next((number for word in words for number, text in enumerate(lines, start=1) if word in text), 1)
