"""Rigid fit of commanded poses to the golden ones: another frame or point, or deltas in another frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import poses, rotation
from xpl_cli.model_io.difference import EpisodeAnswers, columns, differences
from xpl_cli.model_io.explain import TriedChange

if TYPE_CHECKING:
    from xpl_cli.model_io.difference import Differences

_PLACE, _TURN = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)
_LEAST = 12
"""Poses that a constant is drawn from at least."""
_NEAR = 1e-3

Poses = np.ndarray


@dataclass(frozen=True)
class _PoseFit:
    """What the golden poses would be.

    Attributes:
        words: of the change.
        convention: of the vocabulary.
        made: poses (N, 7).
    """

    words: str
    convention: str
    made: Poses


def fit_rigid(
    episodes: Sequence[EpisodeAnswers],
    before: Differences,
    spread: Mapping[str, float],
    tolerance: float,
    tool: Poses | None,
) -> Iterator[TriedChange]:
    """Yield the changes by which all poses that differ are the golden ones, a constant away.

    Args:
        episodes: all episodes.
        before: how far the answers are, by number.
        spread: of `difference.spreads`.
        tolerance: largest share that is no difference.
        tool: pose (7,) of the point between the fingertips in the flange; None if it is not known.
    """
    golden = [chunk for episode in episodes for chunk in episode.golden]
    answers = [chunk for episode in episodes for chunk in episode.adapter]
    if any(len(one) != len(other) for one, other in zip(golden, answers, strict=True)):
        return
    golden_columns, adapter = columns(golden), columns(answers)
    differing_keys = {part.partition("[")[0] for part, share in before.items() if share > tolerance}
    keys = [key for key in golden_columns if key in differing_keys and key.endswith(spec.State.EE_POSE)]
    if not keys or len(golden_columns[keys[0]]) < _LEAST or any(key not in adapter for key in keys):
        return
    states = [episode.observations[index]["state"] for episode in episodes for index in episode.asked_at]
    by_key = {key: _readings(golden_columns[key], adapter[key], _repeated(states, answers, key), tool) for key in keys}
    for readings in zip(*by_key.values(), strict=True):
        remaining = dict(before)
        for key, reading in zip(keys, readings, strict=True):
            remaining.update(_left(key, reading.made, golden_columns[key], spread))
        yield TriedChange(readings[0].words, readings[0].convention, remaining)


def _repeated(states: Sequence[Mapping[str, object]], answers: Sequence[Sequence[object]], key: str) -> Poses:
    return np.stack(
        [np.asarray(state[key], float) for state, chunk in zip(states, answers, strict=True) for _ in chunk]
    )


def _left(key: str, made: Poses, golden: Poses, spread: Mapping[str, float]) -> Differences:
    chunks = [[{key: values} for values in rows] for rows in (golden, made)]
    return differences(
        [chunks[0]], [chunks[1]], {part: value for part, value in spread.items() if part.startswith(key)}
    )


def _readings(golden: Poses, adapter: Poses, start: Poses, tool: Poses | None) -> list[_PoseFit]:
    outer = _mean(rotation.multiply(golden[:, _TURN], rotation.conjugate(adapter[:, _TURN])))
    shift = (golden[:, _PLACE] - rotation.rotate(outer, adapter[:, _PLACE])).mean(0)
    inner = _mean(rotation.multiply(rotation.conjugate(adapter[:, _TURN]), golden[:, _TURN]))
    offset = rotation.rotate(rotation.conjugate(adapter[:, _TURN]), golden[:, _PLACE] - adapter[:, _PLACE]).mean(0)
    readings = [
        _PoseFit(
            _describe_transform("frame", shift, outer), "frame", poses.compose(np.concatenate((shift, outer)), adapter)
        ),
        _PoseFit(
            _describe_transform("point", offset, inner),
            "point",
            poses.compose(adapter, np.concatenate((offset, inner))),
        ),
    ]
    readings += _changes("flange", golden, adapter, start)
    if tool is not None:
        at_tool = (poses.compose(rows, tool) for rows in (golden, adapter, start))
        readings += _changes("tcp", *at_tool, point=tool)
    return readings


def _changes(
    name: str, golden: Poses, adapter: Poses, start: Poses, *, point: Poses | None = None
) -> Iterator[_PoseFit]:
    """Yield what poses would be whose changes of the state are a constant map of what they are."""
    for to in ("fixed", "body"):
        for of in ("fixed", "body"):
            moved, moves = _mapped(*(_moves(rows, start, frame) for rows, frame in ((adapter, of), (golden, to))))
            turned, turns = _mapped(*(_turns(rows, start, frame) for rows, frame in ((adapter, of), (golden, to))))
            positions = start[:, _PLACE] + (moved if to == "fixed" else rotation.rotate(start[:, _TURN], moved))
            turn = rotation.from_axis_angle(turned)
            pair = (turn, start[:, _TURN]) if to == "fixed" else (start[:, _TURN], turn)
            made = np.concatenate((positions, rotation.multiply(*pair)), axis=-1)
            for scope, rows in (("", made), (" of place", _mixed(made, adapter)), (" of turn", _mixed(adapter, made))):
                whole = rows if point is None else poses.compose(rows, poses.invert(point))
                maps = {"": (moves, turns), " of place": (moves,), " of turn": (turns,)}[scope]
                words = f"changes{scope} at the {name}: {to}, not {of}" if to != of else f"changes{scope} at the {name}"
                yield _PoseFit(words + _factors(maps), _convention(to != of, maps), whole)


def _mixed(positions: Poses, rotations: Poses) -> Poses:
    return np.concatenate((positions[:, _PLACE], rotations[:, _TURN]), axis=-1)


def _moves(rows: Poses, start: Poses, frame: str) -> Poses:
    moves = rows[:, _PLACE] - start[:, _PLACE]
    return moves if frame == "fixed" else rotation.rotate(rotation.conjugate(start[:, _TURN]), moves)


def _turns(rows: Poses, start: Poses, frame: str) -> Poses:
    back = rotation.conjugate(start[:, _TURN])
    pair = (rows[:, _TURN], back) if frame == "fixed" else (back, rows[:, _TURN])
    return rotation.to_axis_angle(rotation.multiply(*pair))


def _mapped(source: Poses, target: Poses) -> tuple[Poses, Poses]:
    """Return the vectors that the best linear map makes, and the map (3, 3)."""
    linear = np.linalg.lstsq(source, target, rcond=None)[0]
    return source @ linear, linear.T


def _mean(quaternions: Poses) -> Poses:
    """Return the one rotation that several are, as far as they are one."""
    _, axes = np.linalg.eigh(quaternions.T @ quaternions)
    mean: Poses = axes[:, -1]
    return mean


def _is_scale(linear: Poses) -> bool:
    return bool(np.abs(linear - np.eye(3) * linear[0, 0]).max() < _NEAR)


def _convention(applied: bool, maps: Sequence[Poses]) -> str:  # noqa: FBT001 - of one reading
    if applied:
        return "action_reference"
    return "normalization" if all(map(_is_scale, maps)) else "frame"


def _factors(maps: Sequence[Poses]) -> str:
    if not all(map(_is_scale, maps)):
        return ", along other axes"
    factors = [linear[0, 0] for linear in maps if abs(linear[0, 0] - 1) > _NEAR]
    return "".join(f", times {factor:.4g}" for factor in factors[:1])


def _describe_transform(name: str, position: Poses, turn: Poses) -> str:
    """Return a constant in words: a shift in m, a turn about an axis in degrees."""
    angle = rotation.to_axis_angle(turn)
    degrees = float(np.rad2deg(np.linalg.norm(angle)))
    texts = [f"{name}: moved by [{', '.join(f'{value:.4g}' for value in np.round(position, 4))}] m"]
    if degrees > _NEAR:
        axis = angle / np.linalg.norm(angle)
        texts.append(
            f"turned by {degrees:.4g} deg about [{', '.join(f'{value:.3g}' for value in np.round(axis, 3) + 0.0)}]"
        )
    return ", ".join(texts)
