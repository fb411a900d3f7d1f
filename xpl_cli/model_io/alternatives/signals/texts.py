"""Instructions as models read them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl_cli.model_io.alternatives.signals.signal import Episode, Obs, Shown, Signal

if TYPE_CHECKING:
    from xpl.contract import ObservationDict

_CHANGES: tuple[tuple[int, str, Callable[[str], str]], ...] = (
    (0, "case: lower", str.lower),
    (0, "strip: ' '", lambda text: text.strip(" ")),
    (1, "strip: '. '", lambda text: text.strip(". ")),
    (1, "case: lower, strip: ' '", lambda text: text.strip(" ").lower()),
    (1, "a full stop at the end", lambda text: text.rstrip(". ") + "."),
    (1, "a line break at the end", lambda text: f"{text}\n"),
    (1, "underscores for spaces", lambda text: text.replace(" ", "_")),
    (1, "spaces for underscores", lambda text: text.replace("_", " ")),
    (1, "without punctuation", lambda text: "".join(sign for sign in text if sign.isalnum() or sign in " _")),
    (2, "a capital first", lambda text: text[:1].upper() + text[1:]),
    (2, "strip: line breaks", lambda text: text.strip("\n")),
    (3, "case: upper", str.upper),
    (1, "none", lambda _: ""),
)


def texts(others: Sequence[str] = ()) -> Iterator[Signal]:
    """Yield changes of the instruction; `others` are those of other environments and episodes."""
    for rank, words, change in _CHANGES:
        yield Signal(rank, f"instruction: {words}", spec.Obs.INSTRUCTION, _said(change))
    for other in dict.fromkeys(others):
        yield Signal(1, f"instruction: always {other!r}", spec.Obs.INSTRUCTION, _said(_always(other)))
    yield Signal(1, "instruction: the episode's first", spec.Obs.INSTRUCTION, _first)


def _always(text: str) -> Callable[[str], str]:
    return lambda _said: text


def _said(change: Callable[[str], str]) -> Shown:
    def shown(observations: Sequence[Obs]) -> Episode:
        return [_with(obs, change) for obs in observations]

    return shown


def _with(obs: Obs, change: Callable[[str], str]) -> ObservationDict:
    result = dict(obs)
    if isinstance(result.get(spec.Obs.INSTRUCTION), str):
        result[spec.Obs.INSTRUCTION] = change(result[spec.Obs.INSTRUCTION])
    several = result.get(spec.Obs.INSTRUCTIONS)
    if isinstance(several, (list, tuple)):
        result[spec.Obs.INSTRUCTIONS] = [change(text) for text in several]
    return result


def _first(observations: Sequence[Obs]) -> Episode:
    said = {
        key: observations[0][key] for key in (spec.Obs.INSTRUCTION, spec.Obs.INSTRUCTIONS) if key in observations[0]
    }
    return [{**obs, **said} for obs in observations]
