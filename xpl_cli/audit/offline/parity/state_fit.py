"""Fit of the state that the reference read: numbers of the adapter's state in another scale, or from another zero.

The answers are differentiated by each number of the encoded state. Where a few numbers explain how the answers differ,
scale and offset of each are fitted, the same for all questions, by Levenberg and Marquardt's method.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl.catalogue import Mistake
from xpl.convert import ConversionError, compile_interface
from xpl.observation import ObservationError
from xpl_cli.model_io.difference import aligned_differences

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.offline.search.loaded_adapter import AnswersByQuestion
    from xpl_cli.audit.offline.search.mistake_families import MistakeFamilies
    from xpl_cli.audit.offline.search.session_replay import SessionReplay

_QUESTIONS: Final = 3
_STEP: Final = 0.01
"""Of the range of a number, by which it is moved to differentiate."""
_DISTINCT: Final = 4
"""Answers are rounded if fewer than a fourth of their differences are distinct."""
_LEAST_STEP: Final = 1e-4
_SUPPORT: Final = 4
"""Most numbers that are fitted one by one."""
_HINT: Final = 0.5
"""Least share of the difference that numbers must explain to first order."""
_STARTS: Final = (1.0, 0.1, 0.25, 0.5, 2.0, 4.0, 10.0, -1.0)
"""Scales from which a fit begins; the best one counts."""
_ROUNDS: Final = 12
_DAMPINGS: Final = (1e-4, 1e-2, 1.0, 100.0)
_ZERO: Final = 1e-3
_DEGREES: Final = float(np.rad2deg(1.0))
_NEAR: Final = 2e-3


@dataclass(frozen=True)
class _Number:
    """A number of an encoded state.

    Attributes:
        vector, width: name and width of its vector.
        place: index in it.
        kind: of its part, such as gripper.
        values: in the questions.
        span: of the number over the observations.
    """

    vector: str
    width: int
    place: int
    kind: str
    values: np.ndarray
    span: float

    @property
    def label(self) -> str:
        return f"{self.vector}[{self.place}]"


class StateFit:
    """The fit of one session.

    Args:
        families: of the adapter, whose block has a state.
        replay: the questions.
        judgement: of the adapter's answers.
        seconds: how long it may take.
    """

    def __init__(self, families: MistakeFamilies, replay: SessionReplay, judgement: Judgement, seconds: float) -> None:
        self._families, self._replay, self._judgement = families, replay, judgement
        self._until = families.seconds_left - seconds

    def mistakes(self) -> list[Mistake]:
        """Return the scales and offsets with which the answers are the golden ones; empty if there are none."""
        if not self._numbers or not self._questions or self._is_rounded:
            return []
        start, slopes = self._start, self._differentiate(range(len(self._numbers)), _identity(len(self._numbers)))
        if start is None or slopes is None:
            return []
        for support in self._supports(start, slopes):
            if self._families.seconds_left <= self._until:
                break
            fit = self._fit(support)
            if fit is not None:
                return [self._mistake(support, fit)]
        return []

    # -- what is fitted ------------------------------------------------------------------------------------------------

    @cached_property
    def _questions(self) -> list[int]:
        """Questions that differ, the first of their episodes if there are enough: earlier ones are not asked then."""
        judgement = self._judgement
        wrong = [number for number in self._replay.all_questions if judgement.differs[number]]
        first = [number for number in wrong if len(judgement.session.questions[number].recipes) == 1]
        return (first if len(first) > 1 else wrong)[:_QUESTIONS]

    @cached_property
    def _numbers(self) -> list[_Number]:
        """The numbers of the block's state that change; empty without a block that fits."""
        case = self._families.case
        if not case.block.get("state"):
            return []
        try:
            chunk = self._families.manifest.temporal.chunk
            interface = compile_interface(case.block, case.embodiment, case.action_type, case.folders, chunk)
            rows = [
                interface.encode_state(self._replay.observations_of(self._judgement.session.questions[number])[-1])
                for number in self._replay.all_questions
            ]
        except (ConversionError, ObservationError):
            return []
        places = [self._replay.all_questions.index(number) for number in self._questions]
        found = []
        for name, vector in interface.states.items():
            values = np.stack([row[name] for row in rows]).astype(np.float64)
            kinds = [part.kind for part in vector.parts for _ in range(part.width)]
            for place, kind in enumerate(kinds):
                span = max(float(np.ptp(values[:, place])), 0.05 * float(np.abs(values[:, place]).max()))
                if span > _LEAST_STEP and kind != "rotation":
                    found.append(_Number(name, vector.padded, place, kind, values[places, place], span))
        return found

    def _supports(self, start: np.ndarray, slopes: np.ndarray) -> Iterator[tuple[int, ...]]:
        """Yield sets of numbers that explain the difference to first order, the smallest first."""
        chosen: list[int] = []
        for _ in range(min(_SUPPORT, len(self._numbers))):
            left = [
                self._first_order(start, slopes, [*chosen, number]) if number not in chosen else np.inf
                for number in range(len(self._numbers))
            ]
            chosen.append(int(np.argmin(left)))
        if self._first_order(start, slopes, chosen) > 1.0 - _HINT:
            return
        sets = [tuple(sorted(chosen[: size + 1])) for size in range(len(chosen))]
        kinds = {self._numbers[number].kind for number in chosen[:1]}
        alike = tuple(number for number, one in enumerate(self._numbers) if one.kind in kinds)
        yield from dict.fromkeys([*sets[:2], *([alike] if len(alike) <= 2 * _SUPPORT else []), *sets[2:]])

    def _first_order(self, start: np.ndarray, slopes: np.ndarray, chosen: Sequence[int]) -> float:
        """Return the share of the squared difference that moving some numbers, in each question by itself, leaves."""
        left = 0.0
        for row, by_number in zip(start, slopes, strict=True):
            columns = by_number[list(chosen)].T
            moved, *_ = np.linalg.lstsq(columns, -row, rcond=None)
            left += float(((columns @ moved + row) ** 2).sum())
        return left / max(float((start**2).sum()), 1e-300)

    # -- the fit -------------------------------------------------------------------------------------------------------

    def _fit(self, support: Sequence[int]) -> np.ndarray | None:
        """Return scale and offset of each number, (n, 2); None if no difference stays below the tolerance."""
        begins = [np.tile([scale, 0.0], (len(support), 1)) for scale in _STARTS]
        best, lines = self._best(support, begins)
        tolerance = self._judgement.tolerance
        for _ in range(_ROUNDS):
            if best is None or np.abs(best).max() <= tolerance / 2 or self._families.seconds_left <= self._until:
                break
            slopes = self._differentiate(support, lines)
            if slopes is None:
                break
            values = np.stack([self._numbers[number].values for number in support])
            # The slope by the scale is the one by the offset, times the number.
            columns = np.concatenate([slopes * values.T[:, :, None], slopes], axis=1)
            jacobian, target = np.concatenate(columns.swapaxes(1, 2)), best.ravel()
            normal, gradient = jacobian.T @ jacobian, jacobian.T @ target
            tries = []
            for damping in _DAMPINGS:
                damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
                step = -np.linalg.lstsq(damped, gradient, rcond=None)[0]
                tries.append(lines + step.reshape(2, -1).T)
            reached, tried = self._best(support, tries)
            if reached is None or (reached**2).sum() > 0.98 * (best**2).sum():
                break
            best, lines = reached, tried
        return lines if best is not None and np.abs(best).max() <= 2 * tolerance else None

    def _best(self, support: Sequence[int], tries: Sequence[np.ndarray]) -> tuple[np.ndarray | None, np.ndarray]:
        """Return the smallest residual of some scales and offsets, and these."""
        found = list(zip(self._residuals(support, tries), tries, strict=False))
        known = [(residual, lines) for residual, lines in found if residual is not None]
        return min(known, key=lambda one: float((one[0] ** 2).sum()), default=(None, tries[0]))

    def _differentiate(self, support: Sequence[int], lines: np.ndarray) -> np.ndarray | None:
        """Return the slopes of the residuals, (question, number, residual)."""
        steps = [max(_LEAST_STEP, _STEP * self._numbers[number].span) for number in support]
        tries = [lines]
        for row, step in enumerate(steps):
            moved = lines.copy()
            moved[row, 1] += step
            tries.append(moved)
        begin, *others = self._residuals(support, tries)
        if begin is None or len(others) < len(steps):
            return None
        columns = [(other - begin) / step for other, step in zip(others, steps, strict=True) if other is not None]
        return np.stack(columns, axis=1) if len(columns) == len(steps) else None

    def _residuals(self, support: Sequence[int], tries: Sequence[np.ndarray]) -> list[np.ndarray | None]:
        """Return the residual under each of some scales and offsets, until the time is over."""
        asked = [lines for lines in tries if not np.array_equal(lines, _identity(len(support)))]
        mistakes = [self._mistake(support, lines) for lines in asked]
        seconds = max(self._families.seconds_left - self._until, 1.0)
        answers = iter(self._families.loaded.answers_by_input_change(mistakes, self._questions, seconds))
        found: list[np.ndarray | None] = []
        for lines in tries:
            if np.array_equal(lines, _identity(len(support))):  # the adapter's own answers
                found.append(self._start)
            elif (one := next(answers, None)) is not None:
                found.append(self._residual(one.answers))
        return found

    @cached_property
    def _is_rounded(self) -> bool:
        """Whether answers are rounded, as those in half precision: small changes of the state change none of them."""
        if self._start is None:
            return False
        differences = self._start[np.abs(self._start) > 0]
        return bool(_DISTINCT * len(np.unique(differences.round(9))) < differences.size)

    @cached_property
    def _start(self) -> np.ndarray | None:
        return self._residual({number: self._judgement.answers[number] for number in self._questions})

    def _residual(self, answers: AnswersByQuestion | None) -> np.ndarray | None:
        """Return the differences of answers from the golden ones, (question, number of the answer), in their spread."""
        judgement, rows = self._judgement, []
        for number in self._questions if answers is not None else ():
            chunk = answers[number] if answers is not None else ()
            golden, other = judgement.golden[number], chunk[: len(judgement.golden[number])]
            if len(golden) != len(other):
                return None
            far = aligned_differences(golden, other)
            rows.append(np.concatenate([far[part] / judgement.spread[part] for part in sorted(judgement.spread)]))
        if not rows or any(len(row) != len(rows[0]) or not np.isfinite(row).all() for row in rows):
            return None
        return np.stack(rows)

    def _mistake(self, support: Sequence[int], lines: np.ndarray) -> Mistake:
        """Return the change of the encoded state."""
        numbers = [self._numbers[number] for number in support]
        changes = []
        for width in dict.fromkeys(one.width for one in numbers):
            rows = [row for row, one in enumerate(numbers) if one.width == width]
            changes.append(
                {
                    "kind": "linear",
                    "width": width,
                    "places": [numbers[row].place for row in rows],
                    "scale": [float(lines[row, 0]) for row in rows],
                    "offset": [float(lines[row, 1]) for row in rows],
                }
            )
        how = changes[0] if len(changes) == 1 else {"kind": "several", "of": changes}
        words = [_describe(one, *lines[row]) for row, one in enumerate(numbers)]
        text = ", ".join(one for one in words if one) or "the same"
        return Mistake(1, f"state: {text}", _convention(numbers, lines), input_change=how)


def _identity(count: int) -> np.ndarray:
    return np.tile([1.0, 0.0], (count, 1))


def _describe(number: _Number, scale: float, offset: float) -> str:
    """Return the line of a number as text; "" if it stays."""
    is_scaled, is_moved = abs(scale - 1.0) > _ZERO, abs(offset) > _ZERO * max(number.span, 1.0)
    if not is_scaled and not is_moved:
        return ""
    factor = f"{scale:.4g} * " if is_scaled else ""
    return f"{factor}{number.label}" + (f" {offset:+.4g}" if is_moved else "")


def _convention(numbers: Sequence[_Number], lines: np.ndarray) -> str:
    """Return the convention of scales and offsets by the parts to which the numbers belong."""
    changed = [(one.kind, *lines[row]) for row, one in enumerate(numbers) if _describe(one, *lines[row])]
    if changed and all(kind == "gripper" for kind, *_ in changed):
        return "gripper"
    joints = [one for one in changed if one[0] == "joints"]
    if joints and len(joints) == len(changed):
        if all(
            min(abs(abs(scale) / factor - 1.0) for factor in (_DEGREES, 1 / _DEGREES)) < _NEAR for _, scale, _ in joints
        ):
            return "angle_unit"
        if all(abs(abs(scale) - 1.0) < _NEAR for _, scale, _ in joints):
            return "joint_order"
    return "normalization"
