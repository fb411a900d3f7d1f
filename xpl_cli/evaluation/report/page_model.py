"""The parts of a report's page, as its template and the Markdown read them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from markupsafe import Markup

    from xpl_cli.evaluation.report import latency, provenance


@dataclass(frozen=True)
class HeadFigure:
    """A figure of the head of the page."""

    name: str
    value: str
    note: str


@dataclass(frozen=True)
class LabelledClass:
    """A name and its class in page.css."""

    name: str
    kind: str


@dataclass(frozen=True)
class Bar:
    """A rate as a chart and as text."""

    figure: Markup
    text: str


@dataclass(frozen=True)
class TaskBars:
    """A task's rates, by setting."""

    name: str
    dimension: str | None
    bars: list[Bar]


@dataclass(frozen=True)
class ChartRow:
    """A named figure with its chart."""

    name: str
    text: str
    figure: Markup


@dataclass(frozen=True)
class ChartGroup:
    """Rates by setting, or by dimension."""

    title: str
    rows: list[ChartRow]


@dataclass(frozen=True)
class TableCell:
    """A cell of the table and its class in page.css."""

    value: str
    kind: str


@dataclass(frozen=True)
class TableRow:
    """A row of the table; `total`: over all tasks."""

    total: bool
    cells: list[TableCell]


@dataclass(frozen=True)
class PageTable:
    """The table of all figures."""

    header: list[LabelledClass]
    rows: list[TableRow]


@dataclass(frozen=True)
class EndingCount:
    """How many of the planned episodes ended in one way."""

    kind: str
    name: str
    count: int


@dataclass(frozen=True)
class Reason:
    """What ended episodes without success, and how many."""

    text: str
    count: int


@dataclass(frozen=True)
class Failures:
    """How the planned episodes ended."""

    said: str
    figure: Markup
    parts: list[EndingCount]
    reasons: list[Reason]


@dataclass(frozen=True)
class CorrectionCount:
    """A kind of correction, and how often it was made."""

    name: str
    text: str


@dataclass(frozen=True)
class Headline:
    """The overall success rate, as text and as a chart."""

    rate: str
    unit: str
    said: str
    figure: Markup


@dataclass(frozen=True)
class Contrasts:
    """Settings against the first one; no lines where there is nothing to compare."""

    lines: list[ChartRow]
    title: str = ""
    said: str = ""


@dataclass(frozen=True)
class PageView:
    """The variables of the page's template, in order."""

    title: str
    policy: str
    environment: str
    complete: bool
    state: str
    about: str
    headline: Headline
    facts: list[HeadFigure]
    confidence: str
    settings: list[LabelledClass]
    tasks: list[TaskBars]
    groups: list[ChartGroup]
    contrasts: Contrasts
    table: PageTable
    notes: list[str]
    failures: Failures
    corrections: list[CorrectionCount]
    latency: latency.LatencyView | None
    media_said: str
    versions: list[provenance.ProvenanceItem]
    footer: str
