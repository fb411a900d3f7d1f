"""Lines for findings of a served adapter: where it raised, or else the method that answered."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.rules.model import HANDLER, TRACEBACK, NotApplicable, NotRun
from xpl_cli.audit.static.model_class import ACT, ACT_BATCH, RESET, UPDATE, UPDATE_BATCH, ModelClass

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.rules.model import Finding
    from xpl_cli.audit.rules.registry import Rule
    from xpl_cli.audit.served.recorded_client import AnswerRecorder, RaisedError
    from xpl_cli.audit.static.source import Source
    from xpl_cli.serving.workers.worker_answers import Frame

_LEAST: Final = 8
"""Characters of an error's text by which a finding that quotes it is recognised; fewer occur by chance."""
_QUOTED: Final = 80
"""Characters of it that are compared: findings shorten long ones."""
_NAMED: Final = re.compile(rf"\b({UPDATE_BATCH}|{ACT_BATCH}|{UPDATE}|{ACT})\b")
_IN_PLACE_OF: Final = {
    UPDATE: (UPDATE, "encode"),
    UPDATE_BATCH: (UPDATE_BATCH, UPDATE, "encode"),
    ACT: (ACT, "predict"),
    ACT_BATCH: (ACT_BATCH, ACT, "predict"),
    RESET: (RESET, "reset_env"),
}
"""The methods of an adapter that do the work of an operation; the first that it defines counts."""


def located(finding: Finding, rule: Rule, source: Source, recorder: AnswerRecorder) -> Finding:
    """Return a finding about behaviour with its line.

    Args:
        finding: that of a rule which runs the adapter.
        rule: the rule.
        source: the adapter's files.
        recorder: what it answered so far.
    """
    if finding.path != sdk.File.MODEL_PY or finding.line is not None:
        return finding
    error = _quoted_error(finding, recorder)
    if error is not None:
        file, line, _ = _own_frame(error.frames, source)
        return replace(finding, path=file, line=line, located_by=TRACEBACK)
    with suppress(NotRun, NotApplicable):
        adapter = ModelClass.of(source)
        for name in _handlers(finding, rule, recorder):
            method = adapter.method(name)
            if method is not None:
                return replace(finding, path=method.file, line=method.node.lineno, located_by=HANDLER)
        return replace(finding, path=adapter.file, line=adapter.node.lineno, located_by=HANDLER)
    return finding


def _quoted_error(finding: Finding, recorder: AnswerRecorder) -> RaisedError | None:
    """Return the latest error of the adapter whose text a finding quotes.

    Of a finding that quotes only its code: the error of this rule, if all with this code were raised at one line.
    """
    quoting = " ".join(" ".join(map(str, (finding.message, finding.got, *(finding.evidence or {}).values()))).split())
    errors = list(reversed(recorder.errors))
    for error in errors:
        text = " ".join(error.text.split())[:_QUOTED]
        if len(text) >= _LEAST and text in quoting:
            return error
    alike = [error for error in recorder.recent if error.code and f"an error ({error.code})" in quoting]
    return alike[-1] if len({error.frames[0] for error in alike}) == 1 else None


def _own_frame(frames: tuple[Frame, ...], source: Source) -> Frame:
    """Return the innermost frame in a file of the adapter itself, or else in the code that it brings along."""
    own = set(source.files)
    return next((frame for frame in frames if frame[0] in own), frames[0])


def _handlers(finding: Finding, rule: Rule, recorder: AnswerRecorder) -> Iterator[str]:
    """Yield the methods of the adapter that a finding may be about, the likeliest first."""
    named = _NAMED.search(finding.message)
    last = ACT if recorder.last == sdk.Method.INFER else recorder.last
    for operation in (rule.handler, named.group() if named else "", last, ACT):
        yield from _IN_PLACE_OF.get(operation, ())
