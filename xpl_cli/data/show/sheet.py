"""An episode as a picture: a row of frames for each camera, and the curves below."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from xpl_cli.data.formats.image_files import thumbnail

if TYPE_CHECKING:
    from xpl_cli.data.show.episode_view import Chart, EpisodeView

_WIDE: Final = 1280
_MARGIN: Final = 16
_LINE: Final = 20
_CHART: Final = 110
_INK, _SOFT, _RULE, _PAPER = "#1b1f24", "#5d646d", "#e2e4e7", "#ffffff"
_CURVES: Final = ("#2a6db0", "#c4681c", "#5d7f2a", "#7b5cad", "#247f86", "#b8402f", "#8a6d1f", "#4a5560")


def draw(view: EpisodeView) -> Image.Image:
    """Return the sheet of an episode."""
    rows = [_heading(view), *(_frames(strip) for strip in view.strips)]
    charts = [_chart(chart) for chart in view.charts if chart.curves.size]
    rows += [_beside(charts[index : index + 2]) for index in range(0, len(charts), 2)]
    height = sum(row.height for row in rows) + _MARGIN * (len(rows) + 1)
    sheet = Image.new("RGB", (_WIDE + 2 * _MARGIN, height), _PAPER)
    top = _MARGIN
    for row in rows:
        sheet.paste(row, (_MARGIN, top))
        top += row.height + _MARGIN
    return sheet


def _heading(view: EpisodeView) -> Image.Image:
    rate = f"{view.rate_hz:g} Hz" if view.rate_hz else "rate unknown"
    lines = [
        f"{view.key} of {view.path}",
        f"{view.format}, {view.robot or 'robot unknown'}, {view.steps} steps, {rate}",
        *(f"instruction: {sentence}" for sentence in view.instructions[:3]),
    ]
    row = Image.new("RGB", (_WIDE, _LINE * len(lines)), _PAPER)
    pen = ImageDraw.Draw(row)
    for index, line in enumerate(lines):
        pen.text((0, index * _LINE), line, fill=_INK if index == 0 else _SOFT, font=_font(16 if index == 0 else 13))
    return row


def _frames(strip: Any) -> Image.Image:
    count = max(len(strip.images), 1)
    wide = (_WIDE - 4 * (count - 1)) // count
    small = [thumbnail(image, wide) for image in strip.images]
    row = Image.new("RGB", (_WIDE, _LINE + max((one.shape[0] for one in small), default=0)), _PAPER)
    pen = ImageDraw.Draw(row)
    pen.text((0, 0), f"{strip.name}  {strip.what}", fill=_SOFT, font=_font(13))
    for index, (step, image) in enumerate(zip(strip.steps, small, strict=True)):
        row.paste(Image.fromarray(image), (index * (wide + 4), _LINE))
        pen.text(
            (index * (wide + 4) + 3, _LINE + 1),
            str(step),
            fill=_PAPER,
            font=_font(11),
            stroke_width=1,
            stroke_fill=_INK,
        )
    return row


def _chart(chart: Chart) -> Image.Image:
    wide = (_WIDE - _MARGIN) // 2
    row = Image.new("RGB", (wide, _LINE + _CHART), _PAPER)
    pen = ImageDraw.Draw(row)
    lost = f", {chart.lost} not finite" if chart.lost else ""
    caption = f"{chart.name}  {chart.what}, {chart.low:.4g} to {chart.high:.4g}{lost}"
    pen.text((0, 0), caption, fill=_SOFT, font=_font(13))
    pen.rectangle((0, _LINE, wide - 1, _LINE + _CHART - 1), outline=_RULE)
    span = max(chart.high - chart.low, 1e-12)
    last = max(int(chart.steps[-1]), 1)
    for index in range(chart.curves.shape[1]):
        values = chart.curves[:, index]
        finite = np.isfinite(values)
        across = chart.steps[finite] / last * (wide - 8) + 4
        down = _LINE + 5 + (1 - (values[finite] - chart.low) / span) * (_CHART - 10)
        if len(across) > 1:
            pen.line(list(zip(across, down, strict=True)), fill=_CURVES[index % len(_CURVES)], width=1)
    return row


def _beside(charts: list[Image.Image]) -> Image.Image:
    row = Image.new("RGB", (_WIDE, max(chart.height for chart in charts)), _PAPER)
    for index, chart in enumerate(charts):
        row.paste(chart, (index * (chart.width + _MARGIN), 0))
    return row


def _font(size: int) -> Any:
    return ImageFont.load_default(size)
