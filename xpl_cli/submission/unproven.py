"""What a verification does not prove: the maker of a bundle wants it to be believed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.submission.verify import VerificationReport

_LISTED: Final = 4


def sentences(report: VerificationReport) -> Iterator[str]:
    """Yield what is not proven of a bundle without problems."""
    if any(check.problems for check in report.checks):
        return
    for claim in () if report.verdict is None else report.verdict.unproven:
        yield f"the {claim.claim.subject}: {claim.reason}"
    judged = sum(run.total("judged") for run in report.runs)
    replayed = len(report.pairs)
    if not replayed:
        yield (
            "that any episode comes out as recorded: none was replayed, and consistently edited records look like these"
        )
    elif replayed < judged:
        yield f"that the other {judged - replayed} of {judged} episodes end as recorded: --sample {judged} replays all"
    missing = [part for part in report.parts or () if not part.is_whole]
    if missing:
        parts = [*map(str, missing[:_LISTED]), *([f"{len(missing) - _LISTED} more"] if missing[_LISTED:] else [])]
        yield f"how the policy does in the whole protocol: this is a subset, with {', '.join(parts)}"
    yield "who made the bundle: anybody can"
    yield "how the policy came about: on which data it was trained, and how many others were tried before it"
