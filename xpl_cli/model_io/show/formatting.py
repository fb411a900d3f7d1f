"""Formatting of numbers and shapes on the page and in the picture."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from xpl_cli.basics.phrases import count_noun
from xpl_cli.model_io.statements import Certainty

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Entry
    from xpl_cli.model_io.cited_conventions import CitedConvention
    from xpl_cli.model_io.show.numbers import Number
    from xpl_cli.model_io.show.views import ImageView

HEADS = ("#", "part", "number", "unit", "model gets", "before normalisation", "standard")
ACTION_HEADS = ("#", "part", "number", "unit", "model answers", "after normalisation", "standard")
_NOTHING = 1e-7
"""What rounding leaves of zero."""


def figure(value: float) -> str:
    """Return a number with four digits that tell."""
    return "0" if abs(value) < _NOTHING else f"{value:.4g}"


def figures(values: Sequence[float]) -> str:
    """Return one number, or the first and the last."""
    return " to ".join(figure(value) for value in dict.fromkeys(values))


def row(number: Number) -> tuple[str, ...]:
    """Return a number as a row under `HEADS`."""
    part = f"{number.part}, {number.says}" if number.says else number.part
    before = figures(number.values["before"]) if "before" in number.values else ""
    standard = "; ".join(partner(entry) for entry in number.standard)
    return str(number.index), part, number.name, number.unit, figures(number.values["model"]), before, standard


def partner(entry: Entry) -> str:
    """Return a number of the standard."""
    return f"{entry['name']} = {figures(entry['values'])} {entry['unit']}".rstrip()


def about(view: ImageView) -> str:
    """Return size, type and range of an input."""
    low, high = float(view.values.min()), float(view.values.max())
    shape = " x ".join(map(str, view.shape))
    return f"{shape} {view.dtype}, {figure(low)} to {figure(high)}"


def when(view: ImageView) -> str:
    """Return the moment of a picture."""
    return "" if view.when == 0 else f"{view.when} observation{'s' if view.when > 1 else ''} ago"


def counts(conventions: Sequence[CitedConvention]) -> str:
    """Return how many conventions are known, assumed and unknown, and how many sources do not hold."""
    by_certainty = Counter(one.standing for one in conventions)
    texts = [f"{by_certainty[standing]} {standing}" for standing in Certainty if by_certainty[standing]]
    wrong = sum(one.problem is not None for one in conventions)
    texts += [f"{count_noun(wrong, 'source')} to look at"] if wrong else []
    return f"{count_noun(len(conventions), 'convention')}: {', '.join(texts)}"
