"""The picture of the zoo: policies grouped by family, with a mark for each level that they reached."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Final

from xpl_cli.standard.zoo import policies

if TYPE_CHECKING:
    from xpl_cli.standard.zoo.policies import ZooPolicy

_WIDTH, _EDGE, _COLUMNS, _GAP = 640, 24, 3, 8
_TILE_HEIGHT, _ROW, _HEAD = 26, 32, 34
_TILE = (_WIDTH - 2 * _EDGE - (_COLUMNS - 1) * _GAP) // _COLUMNS
_MARK, _STEP = 9, 12
_GATES: Final = {1: "static", 2: "offline"}
"""The gate whose failed rules a level's mark shows."""

_STYLE: Final = """\
  <!-- Colours for both schemes; a page that offers the choice hands it on by the `color-scheme` of its image. -->
  <style>
    svg { --paper: #fff; --edge: #c9d4da; --ink: #1d2b33; --quiet: #51646f; }
    svg { --line: #00796b; --box: #f2f6f7; --warn: #c77700; }
    @media (prefers-color-scheme: dark) {
      svg { --paper: #1b2126; --edge: #3d4a53; --ink: #e6edf1; --quiet: #a5b4bd; }
      svg { --line: #4fc3b0; --box: #252d33; --warn: #f0a840; }
    }
    text { font: 11.5px system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; fill: var(--ink); }
    .family { font-size: 15px; font-weight: 600; fill: var(--line); }
    .small { fill: var(--quiet); }
    rect { fill: var(--box); stroke: var(--edge); stroke-width: 1.5; }
    .paper { fill: var(--paper); }
    .none { fill: none; stroke: var(--edge); }
    .clean { fill: var(--line); stroke: var(--line); }
    .found { fill: var(--warn); stroke: var(--warn); }
    path { stroke: var(--paper); stroke-width: 2; }
  </style>"""


def drawn(families: Mapping[str, Sequence[ZooPolicy]]) -> str:
    """Return the picture as SVG.

    Args:
        families: the policies by what their family is called, in the order in which they are drawn.
    """
    body: list[str] = []
    y = _EDGE + 18
    for family, members in families.items():
        body.append(_text(_EDGE, y, f"{family} ({len(members)})", "family"))
        for place, policy in enumerate(members):
            x = _EDGE + place % _COLUMNS * (_TILE + _GAP)
            body += _tile(x, y + 10 + place // _COLUMNS * _ROW, policy)
        y += 10 + (len(members) + _COLUMNS - 1) // _COLUMNS * _ROW + _HEAD - 10
    body += _legend(y)
    return "\n".join([*_head(y + 46), *body, "</svg>"]) + "\n"


def _head(height: int) -> Iterator[str]:
    counts = {level: sum(one.level == level for one in policies.policies()) for level in policies.levels()}
    level_counts = ", ".join(
        f"{count} at level {level.number} ({level.word})" for level, count in counts.items() if count
    )
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" role="img" '
        'aria-labelledby="title description">'
    )
    yield '  <title id="title">How far each policy of the field runs here</title>'
    yield f'  <desc id="description">Policies by family, with the levels that each reached: {level_counts}.</desc>'
    yield _STYLE
    yield f'  <rect class="paper" x="1" y="1" width="{_WIDTH - 2}" height="{height - 2}" rx="12"/>'


def _tile(x: int, y: int, policy: ZooPolicy) -> Iterator[str]:
    yield f'  <rect x="{x}" y="{y}" width="{_TILE}" height="{_TILE_HEIGHT}" rx="6"/>'
    yield _text(x + 8, y + 17, policy.title)
    steps = policies.levels()[1:]
    first = x + _TILE - 6 - _STEP * len(steps) + _STEP - _MARK
    for place, level in enumerate(steps):
        yield _mark(first + place * _STEP, y + (_TILE_HEIGHT - _MARK) // 2, _state(policy, level.number))


def _state(policy: ZooPolicy, level: int) -> str:
    """Return how a level is drawn: not reached, reached with failed rules, or reached with nothing wrong."""
    if policy.proof is None or level > policy.proof["level"]:
        return "none"
    gate = next((one for one in policy.proof["gates"] if one["gate"] == _GATES.get(level)), None)
    return "found" if gate is not None and gate["failed"] else "clean"


def _mark(x: int, y: int, state: str) -> str:
    square = f'  <rect class="{state}" x="{x}" y="{y}" width="{_MARK}" height="{_MARK}" rx="2"/>'
    if state != "found":
        return square
    return f'{square}<path d="M{x + 2} {y + _MARK - 2}l{_MARK - 4} -{_MARK - 4}"/>'


def _legend(y: int) -> Iterator[str]:
    levels = ", ".join(f"{level.number} {level.word}" for level in policies.levels()[1:])
    yield _text(_EDGE, y, f"Marks, from the left: {levels}.", "small")
    x = _EDGE
    for state, words, width in (
        ("clean", "ran, nothing wrong", 150),
        ("found", "ran, rules failed", 140),
        ("none", "not proven here", 0),
    ):
        yield _mark(x, y + 16, state)
        yield _text(x + 16, y + 24, words, "small")
        x += width


def _text(x: int, y: int, words: str, kind: str = "") -> str:
    style = f' class="{kind}"' if kind else ""
    return f'  <text{style} x="{x}" y="{y}">{escape(words)}</text>'
