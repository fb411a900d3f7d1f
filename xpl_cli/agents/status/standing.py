"""Where a package stands: all of its steps, what they come to, and what to do next."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.agents.status.memory import recall
from xpl_cli.agents.status.runs import Course, Recorded, recorded
from xpl_cli.agents.status.steps import PLACEHOLDERS, State, Step, steps
from xpl_cli.audit.engine import cache
from xpl_cli.audit.engine.circumstances import of_package
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.verdict import Ended, Verdict, Word, judge
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.strangers import command, one_line
from xpl_cli.packages import package

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from xpl_cli.agents.status.memory import Remembered
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
        steps: all of them, in order.
        verdict: what the last audits come to, as far as they are of the files that are there now; `red` also where
            another step failed, and `incomplete` where one is left.
        runs: evaluations of it, the newest first.
    """

    target: Target
    steps: tuple[Step, ...]
    verdict: Verdict
    runs: tuple[Recorded, ...] = ()

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
            **self.verdict.as_json(),
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
    taken = tuple(steps(target, source, remembered))
    return Standing(target, taken, _verdict(target, source, taken, remembered), found)


def _verdict(target: Target, source: Source, taken: Sequence[Step], remembered: Mapping[str, Remembered]) -> Verdict:
    """Return what is proven of the files that are there now; what is no gate proves nothing, but may be in the way."""
    ends: list[Ended] = []
    settings: list[str] = []
    for step in taken:
        last = remembered.get(step.name)
        if step.name in _GATE_NAMES and last is not None and step.state is not State.STALE:
            ends.append(last.ended)
            settings += last.settings
        elif step.name in _GATE_NAMES or not (step.is_settled or step.name == PLACEHOLDERS):
            outcome = Outcome.FAIL if step.state is State.FAILED else Outcome.NOT_RUN
            ends.append(Ended(step.name, outcome, reason=step.detail))
    asked = tuple(dict.fromkeys(settings))
    narrowed = f"only with --set {', '.join(asked)}" if asked and target.kind == package.ENV else ""
    around = replace(of_package(source, target.kind, target.shown), narrowed=narrowed, settings=asked)
    return judge(target.kind, ends, around)


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
        f"{one.verdict.word.upper():<10}  {names[id(one)]:<{width}}  {one.stage or one_line(one.verdict.said)}"
        for one in sorted(standings, key=lambda one: one.stage is None)[:_MOST_LINES]
    ]
    if len(standings) > _MOST_LINES:
        lines.append(f"and {len(standings) - _MOST_LINES} more: --json has all")
    following = document(standings)["next"][:3]
    return "\n".join([*lines, *(["next", *(f"  {each}" for each in following)] if following else [])])


def _detailed(one: Standing) -> list[str]:
    lines = ["  ".join(map(one_line, (one.target.path.name, one.target.shown)))]
    for step in one.steps:
        when = f" ({step.when})" if step.when else ""
        lines.append(f"  {_MARKS[step.state]:<7}  {step.name:<12}  {one_line(step.detail)}{when}")
    for run in one.runs[:_MOST_RUNS]:
        told = f", {run.unplayed} still to play" if run.unplayed else ""
        lines.append(
            f"  run      {one_line(run.path)}: {_COURSES[run.state]}, {run.episodes} episodes in "
            f"{one_line(run.environment)}{told}"
        )
    is_behind = one.verdict.word in (Word.RED, Word.INCOMPLETE)
    lines.append(f"stands  {one.verdict.word.upper()} {f'at {one.stage}' if is_behind else one_line(one.verdict.said)}")
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
