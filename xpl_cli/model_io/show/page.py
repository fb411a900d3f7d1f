"""The report as one self-contained HTML file."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import image_codec
from xpl_cli.basics import pages
from xpl_cli.model_io.show import formatting
from xpl_cli.model_io.show.sheet import ROBOT

if TYPE_CHECKING:
    from xpl_cli.model_io.show.report import ShowReport
    from xpl_cli.model_io.show.views import ImageView

_WIDEST: Final = 640
"""Pixels of a picture on the page."""


def page(report: ShowReport) -> str:
    """Return the report as HTML."""
    return pages.render(
        "model_io/show.html.jinja",
        style="model_io/show.css",
        report=report,
        pictures=[_picture(view) for view in report.views],
        vectors=[
            {
                "input": vector.input,
                "words": vector.words,
                "heads": formatting.HEADS,
                "rows": [formatting.row(number) for number in vector.numbers],
            }
            for vector in report.vectors
        ],
        texts=[
            {"input": name, "standard": repr(report.instruction), "model": repr(text)}
            for name, text in report.texts.items()
        ],
        action={"heads": formatting.ACTION_HEADS, "rows": [formatting.row(one) for one in report.action]}
        if report.action
        else None,
        conventions=report.conventions,
        counts=formatting.counts(report.conventions),
        figures=[figure.svg() for figure in report.figures],
        robot=ROBOT,
    )


def _picture(view: ImageView) -> dict[str, Any]:
    return {
        "camera": view.camera,
        "input": view.input,
        "when": formatting.when(view),
        "taken": _data(view.taken),
        "seen": _data(view.seen),
        "raw": _data(view.raw),
        "size": " x ".join(map(str, view.taken.shape)),
        "words": ", ".join(view.words),
        "about": formatting.about(view),
        "notes": view.notes,
    }


def _data(picture: np.ndarray) -> str:
    from PIL import Image

    made = Image.fromarray(np.ascontiguousarray(picture))
    if made.width > _WIDEST:
        made = made.resize((_WIDEST, max(1, round(made.height * _WIDEST / made.width))))
    return f"data:image/png;base64,{base64.b64encode(image_codec.encode_png(np.asarray(made))).decode()}"
