"""XPL242: Gripper commands are inverted, in another unit, or those of the other arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.changed_inputs import with_gripper
from xpl_cli.audit.served.compare import structure_problem
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer

_OPENINGS = np.linspace(spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN, 6)
_ORDERS = ([0, 1, 2, 3, 4, 5], [3, 0, 4, 1, 5, 2])
"""In which order the arms have the openings, so that one gripper is not taken for another."""
_SCENES = (0, 1)
_EXACT = 1e-3
"""How exactly commands have to lie on a line, in both scenes alike, to be a copy and no decision."""
_NEAR = 0.02
_UNIT = 0.3
"""A share of the opening that, in a single action step, is another unit and no gripper that is being closed."""
_COMPARE = "compare the gripper with the authors' own code, in the state that is encoded and in the action"


@rule(code="XPL242", requirement="XPL-ACT-5", profile="full", tries="grippers")
def gripper_direction(probe: Probe) -> Iterator[Finding]:
    """Gripper commands are inverted, in another unit, or those of the other arm.

    ## What it does
    Sends observations with grippers closed, open and in between, different for each arm, in two scenes. If commands are
    the same linear function of the observed opening in both scenes, that function has to be the identity: not 1 minus
    it (closed and open swapped), not a fraction of it (metres for a fraction of the stroke), not the other arm's. For
    other policies only the model's own actions or a simulator can show a mistake.

    ## Why it matters
    The gripper opens when it should hold, or never opens. Everything else looks right.

    ## Example
    `1 - gripper`, for a model whose data had 0 for open, on one side of the model only.

    ## Use instead
    0 for closed and 1 for open, in the state that is encoded and in the action that is decoded.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    keys = [
        arm.prefix + spec.State.EE_JOINT_STATE for arm in probe.embodiment.arms if arm.gripper == "parallel_gripper"
    ]
    if not keys:
        raise NotApplicable("the robot has no gripper that opens and closes")
    chunks = [_answers(probe, keys, scene) for scene in _SCENES]
    undecided, is_sound = [], True
    for key in keys:
        lines = [line for answered in chunks for line in _lines(answered, keys, key)]
        if lines[0] is None or None in lines or np.ptp(np.array(lines), axis=0).max() > _EXACT:
            undecided.append(key)
            continue
        *slopes, offset = lines[0]
        own, others = slopes.pop(keys.index(key)), slopes
        fault = _fault(own, others, offset, steps=len(chunks[0][0]))
        if fault is None and abs(own - 1) + abs(offset) + sum(map(abs, others)) > _NEAR:
            undecided.append(key)
        elif fault is not None:
            is_sound = False
            commands = [float(np.ravel(chunk[0][key])[0]) for chunk in chunks[0]]
            yield blame(
                f"commands of {key} are a copy of the observed gripper, but {fault}",
                expected=f"{np.round(_OPENINGS[_ORDERS[keys.index(key) % 2]], 3).tolist()} for grippers observed there",
                got=f"{np.round(commands, 3).tolist()}",
                fix=Fix("advice", _COMPARE),
            )
    if undecided and is_sound:
        raise NotApplicable(
            f"commands of {', '.join(undecided)} are no copy of the observed opening: only the model's own "
            "pipeline shows their meaning"
        )


def _answers(probe: Probe, keys: Sequence[str], scene: int) -> list[Answer]:
    """Return the chunks that answer each opening in one scene."""
    plain = {**probe.observation(scene), spec.Obs.ENV_IDX: 0}
    chunks = []
    with probe.session() as policy:
        for position in range(len(_OPENINGS)):
            obs = plain
            for number, key in enumerate(keys):
                obs = with_gripper(obs, key, float(_OPENINGS[_ORDERS[number % 2][position]]))
            chunks.append(policy.act(obs))
    if any(structure_problem(chunk, probe.embodiment, probe.action_type) for chunk in chunks):
        raise NotApplicable("some observed openings give no action")
    return chunks


def _lines(chunks: Sequence[Answer], keys: Sequence[str], key: str) -> Iterator[list[float] | None]:
    """Yield of each action step how it follows the grippers: a slope for each and an offset; None if it does not."""
    openings = [_OPENINGS[_ORDERS[number % 2]] for number in range(len(keys))]
    columns = np.stack([*openings, np.ones(len(_OPENINGS))], axis=1)
    for index in range(min(map(len, chunks))):
        commands = np.array([float(np.ravel(chunk[index][key])[0]) for chunk in chunks])
        line = np.linalg.lstsq(columns, commands, rcond=None)[0]
        is_straight = np.abs(columns @ line - commands).max() <= _EXACT and np.abs(line[:-1]).max() > _EXACT
        yield line.tolist() if is_straight else None


def _fault(own: float, others: Sequence[float], offset: float, steps: int) -> str | None:
    """Return what is wrong with a line that commands follow, None if it is right or tells nothing."""
    of_others = max(others, key=abs, default=0.0)
    if abs(own) < _NEAR and abs(abs(of_others) - 1) < _NEAR and abs(offset - (of_others < 0)) < _NEAR:
        return "of the other arm's: the arms' grippers are swapped"
    if abs(of_others) > _NEAR:
        return None
    if abs(own + 1) < _NEAR and abs(offset - 1) < _NEAR:
        return "open and closed are swapped: the gripper would open when it has to hold"
    is_share = _EXACT < own < (1 - _NEAR if steps > 1 else _UNIT)
    if is_share and abs(offset) <= _EXACT:
        return f"{own:.3g} times as far: in another unit than shares of the stroke, or scaled; it would never open"
    return None
