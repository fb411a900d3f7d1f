"""Where a package stands: all of its steps, what they come to, and what to do next."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.agents.status.memory import recall
from xpl_cli.agents.status.runs import Course, Recorded, recorded
from xpl_cli.agents.status.steps import State, Step, steps
from xpl_cli.audit.engine import cache
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.strangers import command, one_line
from xpl_cli.packages import package

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.packages.targets import Target

SCHEMA: Final = "xpl.status/1"
_MOST_LINES: Final = 40
_MOST_RUNS: Final = 5
_EPISODES: Final = 10


@dataclass(frozen=True)
class Standing:
    """Where one package stands.

    Attributes:
        target: the package.
        version: of the standard, to which it is held.
        steps: all of them, in order.
        runs: evaluations of it, the newest first.
    """

    target: Target
    version: str
    steps: tuple[Step, ...]
    runs: tuple[Recorded, ...] = ()

    @property
    def verdict(self) -> str:
        """`red` where a step failed, `green` where nothing is left to do, else `incomplete`."""
        if any(step.state is State.FAILED for step in self.steps):
            return "red"
        return "green" if all(step.is_settled for step in self.steps) else "incomplete"

    @property
    def stage(self) -> str | None:
        """Name of the first step that is not settled; None if all are."""
        return next((step.name for step in self.steps if not step.is_settled), None)

    @property
    def following(self) -> list[str]:
        """Exact commands that come next, in order.

        Those of the first gate that is not settled stand for all that follow: an audit takes them in one run. Where
        only an edit is left, that is what comes after it.
        """
        unsettled = [step for step in self.steps if not step.is_settled]
        if not unsettled:
            return _evaluations(self.target, self.runs)
        gates = [step for step in unsettled if step.name in _GATE_NAMES]
        chosen = [step for step in unsettled if step not in gates[1:]]
        commands = list(dict.fromkeys(each for step in chosen for each in step.commands))
        return commands or [command(["xpl", "audit", self.target.shown])]

    def as_json(self) -> dict[str, Any]:
        """Return it as one of `packages` of the answer."""
        return {
            "path": self.target.shown,
            "name": self.target.path.name,
            "kind": self.target.kind,
            "spec": self.version,
            "verdict": self.verdict,
            "stage": self.stage,
            "steps": [_step_json(step) for step in self.steps],
            "runs": [{**asdict(run), "state": run.state.value} for run in self.runs],
            "next": self.following,
        }


def standing(target: Target) -> Standing:
    """Return where a package stands."""
    source = Source(target.path)
    folder = memory_folder()
    remembered = {} if folder is None else recall(folder, target.path)
    found = recorded(target) if target.kind == package.POLICY else ()
    return Standing(target, source.version, tuple(steps(target, source, remembered)), found)


def memory_folder() -> Path | None:
    """Return where the outcomes of audits are kept, None where the user has no cache."""
    audits = cache.default_folder()
    return None if audits is None else audits.with_name("status")


def document(standings: Sequence[Standing]) -> dict[str, Any]:
    """Return the answer `xpl.status/1`."""
    following = dict.fromkeys(each for one in standings for each in one.following)
    if len(standings) > 1:
        following = dict.fromkeys(command(["xpl", "status", one.target.shown]) for one in _unsettled(standings))
    return {"schema": SCHEMA, "packages": [one.as_json() for one in standings], "next": list(following)}


def text(standings: Sequence[Standing]) -> str:
    """Return the answer for people: a package by its steps, several by a line each."""
    if len(standings) == 1:
        return "\n".join(_detailed(standings[0]))
    names = {id(one): one_line(one.target.shown) for one in standings}
    width = max(map(len, names.values()))
    lines = [
        f"{one.verdict.upper():<10}  {names[id(one)]:<{width}}  {one.stage or ''}".rstrip()
        for one in sorted(standings, key=lambda one: one.stage is None)[:_MOST_LINES]
    ]
    if len(standings) > _MOST_LINES:
        lines.append(f"and {len(standings) - _MOST_LINES} more: --json has all")
    following = document(standings)["next"][:3]
    return "\n".join([*lines, *(["next", *(f"  {each}" for each in following)] if following else [])])


def _detailed(one: Standing) -> list[str]:
    shown = [step for step in one.steps if step.name != "update" or not step.is_settled]
    lines = ["  ".join(map(one_line, (one.target.path.name, one.target.shown, str(one.version))))]
    for step in shown:
        when = f" ({step.when})" if step.when else ""
        lines.append(f"  {_MARKS[step.state]:<7}  {step.name:<12}  {one_line(step.detail)}{when}")
    for run in one.runs[:_MOST_RUNS]:
        told = f", {run.unplayed} still to play" if run.unplayed else ""
        lines.append(
            f"  run      {one_line(run.path)}: {_COURSES[run.state]}, {run.episodes} episodes in "
            f"{one_line(run.environment)}{told}"
        )
    stage = f" at {one.stage}" if one.stage else ""
    lines.append(f"stands  {one.verdict.upper()}{stage}")
    return [*lines, *(["next", *(f"  {each}" for each in one.following)] if one.following else [])]


def _unsettled(standings: Sequence[Standing]) -> list[Standing]:
    return [one for one in standings if one.stage is not None]


def _evaluations(target: Target, runs: Sequence[Recorded]) -> list[str]:
    """Return what comes after green: to go on with what was cut off, to read what is complete, or to begin."""
    if target.kind == package.ENV:
        return []
    broken = [run for run in runs if run.state is Course.INTERRUPTED]
    if broken:
        return [command(["xpl", "eval", target.shown, "--out", run.path, "--resume"]) for run in broken]
    complete = [run.path for run in runs if run.state is Course.COMPLETE]
    if complete:
        return [command(["xpl", "report", *complete[:1]])]
    return [command(["xpl", "eval", target.shown, "--env", "mujoco", "--episodes", str(_EPISODES)])]


def _step_json(step: Step) -> dict[str, Any]:
    return {**asdict(step), "state": step.state.value}


_GATE_NAMES: Final = frozenset(gate.value for gate in Gate)
_COURSES: Final = {
    Course.COMPLETE: "complete",
    Course.INTERRUPTED: "interrupted",
    Course.OTHER_FILES: "of other files than there are now",
}
_MARKS: Final = {
    State.DONE: "done",
    State.OPEN: "open",
    State.FAILED: "FAILED",
    State.STALE: "stale",
    State.PARTIAL: "partial",
    State.NOT_RUN: "not run",
    State.NOT_APPLICABLE: "n/a",
}
