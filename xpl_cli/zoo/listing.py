"""Listing and description of the zoo's policies, as text and as JSON values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.basics.errors import one_of
from xpl_cli.standard.zoo import policies

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.standard.zoo.policies import ZooPolicy

UNKNOWN: Final = "-"
"""Unknown values in a table."""


@dataclass(frozen=True)
class PolicyFilter:
    """A filter of policies.

    Attributes:
        family: of this family; None for any.
        robot: for this robot.
        level: of this level, or a higher one.
    """

    family: str | None = None
    robot: str | None = None
    level: int = 0

    def fits(self, policy: ZooPolicy) -> bool:
        """Tell whether a policy matches; a policy without known robots matches no robot."""
        return (
            self.family in (None, policy.family)
            and (self.robot is None or self.robot in (policy.facts["robots"].value or ()))
            and policy.level.number >= self.level
        )


def filter_policies(policy_filter: PolicyFilter) -> list[ZooPolicy]:
    """Return the matching policies.

    Raises:
        UnknownNameError: the family or robot does not exist.
    """
    if policy_filter.family is not None:
        one_of("--family", policy_filter.family, policies.families())
    if policy_filter.robot is not None:
        from xpl import robots

        one_of("--robot", policy_filter.robot, robots.entries())
    return [policy for policy in policies.policies() if policy_filter.fits(policy)]


def as_json(policy: ZooPolicy) -> dict[str, Any]:
    """Return all facts of a policy as JSON values."""
    return {
        "name": policy.name,
        "title": policy.title,
        "in_paper": policy.in_paper,
        "level": policy.level.number,
        "word": policy.level.word,
        "why_not_further": policy.next,
        "facts": {key: fact.as_json() for key, fact in policy.facts.items()},
        "proof": policy.proof,
    }


def table(selected: Sequence[ZooPolicy]) -> str:
    """Return a table with one line per policy, and the number of policies of each level."""
    rows = [["policy", "family", "level", "proven", "verdict", "robots", "chunk", "license"]]
    rows += [list(_row(policy)) for policy in selected]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines, "", *_level_counts(selected)])


def _row(policy: ZooPolicy) -> Iterator[str]:
    facts, proof = policy.facts, policy.proof
    yield policy.name
    yield policy.family or UNKNOWN
    yield f"{policy.level.number} {policy.level.word}"
    yield proof["date"] if proof is not None else UNKNOWN
    yield policy.outcome or UNKNOWN
    yield ", ".join(facts["robots"].value or (UNKNOWN,))
    yield str(facts["chunk"].value or UNKNOWN)
    yield facts["license"].value or UNKNOWN


def _level_counts(selected: Sequence[ZooPolicy]) -> Iterator[str]:
    counts = {level: sum(policy.level == level for policy in selected) for level in policies.levels()}
    counts_text = ", ".join(
        f"{count} at level {level.number} ({level.word})" for level, count in counts.items() if count
    )
    yield (
        f"{len(selected)} {'policy' if len(selected) == 1 else 'policies'}: {counts_text}"
        if selected
        else "no policy fits"
    )


def describe(policy: ZooPolicy) -> str:
    """Return all facts of one policy as text."""
    return "\n".join(_description_lines(policy))


def _description_lines(policy: ZooPolicy) -> Iterator[str]:
    level, proof = policy.level, policy.proof
    paper = "" if policy.in_paper else ", not in the table of the paper"
    yield f"{policy.name}: {policy.title}{paper}"
    yield _line("level", f"{level.number} {level.word}: {level.meaning}")
    if proof is not None:
        yield _line("proven", f"{proof['date']} by {policy.prover}: {proof['command']}")
        commit = proof["adapter"]["commit"] or "no commit"
        yield _line("of", f"{proof['adapter']['folder']} at {commit[:12]}, files {proof['adapter']['files'][:16]}")
        yield _line("verdict", proof["statement"])
        for gate in proof["gates"]:
            counts = ", ".join(f"{number} {outcome}" for outcome, number in gate["counts"].items())
            yield _line(gate["gate"], f"{gate['outcome']}: {counts}; digest {gate['digest'] or UNKNOWN}")
    if policy.next is not None:
        yield _line("no further", policy.next)
    yield ""
    for key, fact in policy.facts.items():
        if fact.unknown is not None:
            yield _line(key, f"unknown: {fact.unknown}")
        else:
            yield _line(key, f"{_plain(fact.value)}  [{fact.source}]")
        if fact.note is not None:
            yield _line("", fact.note)


def _line(name: str, text: str) -> str:
    return f"  {name:<10}  {text}"


def _plain(value: object) -> str:
    """Return a fact's value as text."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(str(entry) for entry in value.values() if entry is not None)
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
