"""A review as Markdown: one comment on a pull request."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from xpl_cli.agents.review.markdown import (
    cell,
    closing_sections,
    code,
    finding_lines,
    gate_summary,
    location,
    verdict_with_icon,
)
from xpl_cli.audit.formats.listing import shortened
from xpl_cli.audit.rules.verdict import VerdictStatus, verdict_of
from xpl_cli.basics.phrases import count_noun
from xpl_cli.basics.untrusted import command, in_markdown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.agents.review.review import Review, ReviewFinding

MARK: Final = "<!-- xpl review -->"
"""First line, by which a bot finds its earlier comment."""

_LONGEST: Final = 60_000
"""Most characters; a comment on a pull request may have 65,536."""

_LINE: Final = 1500
_ROWS: Final = 30
_HEADS = {
    VerdictStatus.GREEN: "nothing to fix",
    VerdictStatus.PARTIAL: "nothing to fix in what was checked",
    VerdictStatus.SHADOW: "nothing to fix, checked without the model",
    VerdictStatus.OPEN: "nothing to fix, but placeholders to fill in",
    VerdictStatus.INCOMPLETE: "not everything could be checked",
    VerdictStatus.RED: "changes are needed",
}


def render(review: Review) -> str:
    """Return the review as Markdown that fits into one comment."""
    lines = [MARK, f"## xpl review: {_HEADS[review.verdict]}", "", *_summary(review), *_packages(review)]
    lines += _description(review)
    if review.remarks:
        lines += ["", "### Findings", ""]
        for number, remark in enumerate(review.reported, start=1):
            lines += _finding_item(number, remark)
        lines += _left_out(review)
    lines += closing_sections(review.reports, review.context)
    return _truncate(lines)


def _summary(review: Review) -> Iterator[str]:
    change = review.change
    since = f"{code(change.ref)} ({change.base[:10]})"
    if not change.packages:
        gone = ", and removes some" if change.removed else ""
        yield f"This change touches no policy and no environment to audit{gone}, since {since}."
    else:
        fails = sum(1 + len(remark.others) for remark in review.remarks if remark.first.fails)
        warns = sum(1 + len(remark.others) for remark in review.remarks if not remark.first.fails)
        counts = f"{count_noun(fails, 'finding')} to fix and {count_noun(warns, 'warning')}"
        yield f"{count_noun(len(change.packages), 'package')} touched since {since}: {counts}."
        if review.forgives:
            yield "Findings that the base has already do not count."
    for name in change.removed:
        yield f"{code(name)} was removed."
    if change.elsewhere:
        yield f"{count_noun(len(change.elsewhere), 'file')} outside of packages: not reviewed."


def _packages(review: Review) -> Iterator[str]:
    if not review.reports:
        return
    yield from ("", "| package | | verdict | gates |", "| --- | --- | --- | --- |")
    for touched, report in list(zip(review.change.packages, review.reports, strict=True))[:_ROWS]:
        gates = "; ".join(f"{gate.name}: {gate_summary(gate)}" for gate in report.gates) or "nothing was checked"
        yield f"| {cell(touched.path)} | {touched.change} | {verdict_with_icon(verdict_of(report))} | {gates} |"
    if len(review.reports) > _ROWS:
        yield f"\nand {count_noun(len(review.reports) - _ROWS, 'package')} more."


def _description(review: Review) -> Iterator[str]:
    description = review.description
    if description is None or not (description.problems or description.notes):
        return
    yield from ("", "### Description", "")
    yield from (f"- {in_markdown(sentence)}" for sentence in description.problems)
    yield from (f"- {in_markdown(sentence)} (note)" for sentence in description.notes)


def _finding_item(number: int, remark: ReviewFinding) -> Iterator[str]:
    """Yield the lines of one finding, an item of a numbered list."""
    first = remark.first
    marks = [] if first.fails else ["warning"]
    marks += ["already in the base"] if remark.is_old else []
    labels = f" ({', '.join(marks)})" if marks else ""
    item = f"{number}. "
    yield f"{item}**{first.title}**{labels} {location(first)}: {remark.harm.sentence}  "
    yield from (f"{' ' * len(item)}{shortened(line, _LINE)}" for line in finding_lines(first.finding))
    if remark.others:
        locations = dict.fromkeys(location(entry) for entry in remark.similar)
        rest = len(remark.others) - len(remark.similar)
        more = f", and {rest} more" if rest else ""
        yield f"{' ' * len(item)}- also {', '.join(locations)}{more}"


def _left_out(review: Review) -> Iterator[str]:
    rest = review.remarks[len(review.reported) :]
    if rest:
        rules = Counter(remark.first.result.code for remark in rest)
        yield f"\n{count_noun(len(rest), 'finding')} of less harm not listed: {', '.join(sorted(rules))}."
        paths = dict.fromkeys(remark.first.target.path for remark in rest)
        yield f"\n    {command(['xpl', 'audit', *paths])}"


def _truncate(lines: Sequence[str]) -> str:
    """Join lines, truncated to the length of a comment."""
    result, length = [], 0
    for line in lines:
        length += len(line) + 1
        if length > _LONGEST:
            result.append("\nThis review was truncated to the length of a comment.")
            break
        result.append(line)
    return "\n".join(result) + "\n"
