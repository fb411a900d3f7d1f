"""A review for people: one comment on a pull request."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from xpl_cli.agents.review.markdown import besides, cell, code, ended, marked, place, told
from xpl_cli.audit.formats.listing import shortened
from xpl_cli.audit.rules.verdict import Word, judged
from xpl_cli.basics.untrusted import command, in_markdown
from xpl_cli.basics.words import amount

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.agents.review.review import Remark, Review

MARK: Final = "<!-- xpl review -->"
"""The first line, by which a bot finds the comment that it wrote before."""

_LONGEST: Final = 60_000
"""Characters; the comment of a pull request takes 65,536."""

_LINE: Final = 1500
_ROWS: Final = 30
_HEADS = {
    Word.GREEN: "nothing to mend",
    Word.PARTIAL: "nothing to mend in what was checked",
    Word.SHADOW: "nothing to mend, checked without the model",
    Word.OPEN: "nothing to mend, and places to fill in",
    Word.INCOMPLETE: "not everything could be checked",
    Word.RED: "changes are needed",
}


def render(review: Review) -> str:
    """Return the review as Markdown that fits into one comment."""
    lines = [MARK, f"## xpl review: {_HEADS[review.verdict]}", "", *_summary(review), *_packages(review)]
    lines += _description(review)
    if review.remarks:
        lines += ["", "### Findings", ""]
        for number, remark in enumerate(review.told, start=1):
            lines += _remark(number, remark)
        lines += _left_out(review)
    lines += besides(review.reports, review.context)
    return _bounded(lines)


def _summary(review: Review) -> Iterator[str]:
    change = review.change
    since = f"{code(change.ref)} ({change.base[:10]})"
    if not change.packages:
        gone = ", and takes some away" if change.removed else ""
        yield f"This change touches no policy and no environment that there is to audit{gone}, since {since}."
    else:
        fails = sum(1 + len(remark.others) for remark in review.remarks if remark.first.fails)
        warns = sum(1 + len(remark.others) for remark in review.remarks if not remark.first.fails)
        found = f"{amount(fails, 'finding')} to mend and {amount(warns, 'warning')}"
        yield f"{amount(len(change.packages), 'package')} touched since {since}: {found}."
        if review.forgives:
            yield "What was there before does not count here."
    for name in change.removed:
        yield f"{code(name)} is gone."
    if change.elsewhere:
        yield f"{amount(len(change.elsewhere), 'file')} outside of packages: not looked at here."


def _packages(review: Review) -> Iterator[str]:
    if not review.reports:
        return
    yield from ("", "| package | | verdict | gates |", "| --- | --- | --- | --- |")
    for touched, report in list(zip(review.change.packages, review.reports, strict=True))[:_ROWS]:
        gates = "; ".join(f"{gate.name}: {ended(gate)}" for gate in report.gates) or "nothing was checked"
        yield f"| {cell(touched.place)} | {touched.change} | {marked(judged(report))} | {gates} |"
    if len(review.reports) > _ROWS:
        yield f"\nand {amount(len(review.reports) - _ROWS, 'package')} more."


def _description(review: Review) -> Iterator[str]:
    description = review.description
    if description is None or not (description.problems or description.notes):
        return
    yield from ("", "### Description", "")
    yield from (f"- {in_markdown(sentence)}" for sentence in description.problems)
    yield from (f"- {in_markdown(sentence)} (note)" for sentence in description.notes)


def _remark(number: int, remark: Remark) -> Iterator[str]:
    """Yield the lines of one finding, an item of a numbered list."""
    first = remark.first
    marks = [] if first.fails else ["warning"]
    marks += ["was there before"] if remark.is_old else []
    shown = f" ({', '.join(marks)})" if marks else ""
    item = f"{number}. "
    yield f"{item}**{first.title}**{shown} {place(first)}: {remark.harm.sentence}  "
    yield from (f"{' ' * len(item)}{shortened(line, _LINE)}" for line in told(first.finding))
    if remark.others:
        places = dict.fromkeys(place(entry) for entry in remark.similar)
        rest = len(remark.others) - len(remark.similar)
        more = f", and {rest} more" if rest else ""
        yield f"{' ' * len(item)}- also {', '.join(places)}{more}"


def _left_out(review: Review) -> Iterator[str]:
    rest = review.remarks[len(review.told) :]
    if rest:
        rules = Counter(remark.first.result.code for remark in rest)
        yield f"\n{amount(len(rest), 'finding')} of less harm not told: {', '.join(sorted(rules))}."
        paths = dict.fromkeys(remark.first.target.path for remark in rest)
        yield f"\n    {command(['xpl', 'audit', *paths])}"


def _bounded(lines: Sequence[str]) -> str:
    """Return lines as a text, cut where a comment would be too long."""
    kept, length = [], 0
    for line in lines:
        length += len(line) + 1
        if length > _LONGEST:
            kept.append("\nThis review was cut here: a comment takes no more.")
            break
        kept.append(line)
    return "\n".join(kept) + "\n"
