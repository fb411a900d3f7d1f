"""Whether a policy answers what it was shown last: a loop is repeated to it, with single observations changed.

The observations are those of a real loop, and stay the same whatever is answered: so an answer that differs from the
one in the loop shows what was changed before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.client import PolicyServerError
from xpl_cli.audit.rules.model import NotApplicable, NotRun
from xpl_cli.audit.served import changed_inputs
from xpl_cli.audit.served.compare import same
from xpl_cli.audit.served.effects import Scale, is_weak

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import ObservationDict
    from xpl_cli.audit.physics.loop import Show
    from xpl_cli.audit.physics.simulation import Simulation
    from xpl_cli.audit.served.recorded_client import Answer

_CONSTANT = (sdk.Obs.INSTRUCTION, sdk.Obs.PRIVILEGED)
"""Inputs that stay what they are in an episode, or whose form no standard tells."""
_TRIED = (1, 2, 3)
"""Questions before which an observation is changed; the first one has none before it."""


@dataclass(frozen=True)
class Reaction:
    """How far an answer moves when one observation is another one, in shares of how far all answers lie apart.

    Attributes:
        question: the one before which, or just before whose newest observation, something was changed.
        newest: its own answer, with the newest observation changed.
        older: the same, with the observation of the step before changed; None where that is the newest of a question.
        late: the answer to the next question, with what was newest here changed.
    """

    question: int
    newest: float
    older: float | None
    late: float

    @property
    def before(self) -> float:
        """How far an answer moves with an observation that is not its newest."""
        return max(self.late, self.older or 0.0)

    @property
    def lags(self) -> bool:
        """Whether the answer is to something older than the newest observation."""
        return is_weak(self.newest, self.before)


def reactions(simulation: Simulation) -> list[Reaction]:
    """Return how a policy reacts, up to the first answer that follows the newest observation.

    Raises:
        NotApplicable: if nothing can be changed, or no answer depends on it.
        NotRun: if the same observations are answered differently.
    """
    show = simulation.show(max(_TRIED) + 2)
    names = _changeable(simulation, show.observations[0])
    if len(show.asked) <= _TRIED[0] + 1:
        raise NotApplicable("the loop has too few chunks")
    usual = _replayed(simulation, show, show.observations)
    if not same(usual, _replayed(simulation, show, show.observations)):
        raise NotRun("the policy answers the same observations differently: same-seed-same-motion says how")
    found = []
    for question in [number for number in _TRIED if number + 1 < len(show.asked)]:
        step = show.asked[question]
        changed = _replayed(simulation, show, _with_change(show, step, names))
        before = None
        if step - 1 not in show.asked:
            before = _replayed(simulation, show, _with_change(show, step - 1, names))
        scale = Scale([*usual, *changed, *(before or ())])
        newest, late = (scale.effect(usual[place], changed[place]) for place in (question, question + 1))
        older = None if before is None else scale.effect(usual[question], before[question])
        found.append(Reaction(question, newest, older, late))
        if not found[-1].lags and newest:
            break
    if not any(reaction.newest or reaction.before for reaction in found):
        raise NotApplicable("no answer in the middle of the loop depends on what is observed then")
    return found


def _changeable(simulation: Simulation, obs: ObservationDict) -> list[str]:
    held = changed_inputs.present(obs)
    names = [name for name in simulation.probe.required or held if name in held and name not in _CONSTANT]
    if not names:
        raise NotApplicable("the manifest requires no input that changes in an episode and can be changed by an audit")
    return names


def _with_change(show: Show, step: int, names: Sequence[str]) -> tuple[ObservationDict, ...]:
    obs = show.observations[step]
    for name in names:
        obs = changed_inputs.varied(obs, name)
    return (*show.observations[:step], obs, *show.observations[step + 1 :])


def _replayed(simulation: Simulation, show: Show, observations: Sequence[ObservationDict]) -> list[Answer]:
    """Show observations one after the other and return the answers.

    Raises:
        NotRun: if there is an error in place of one.
    """
    answers = []
    with simulation.steady() as policy:
        policy.reset()
        for step, obs in enumerate(observations[: show.asked[-1] + 1]):
            told = [policy.update_obs_batch([obs])]
            if step in show.asked:
                told.append(policy.get_action_batch([obs[sdk.Obs.ENV_IDX]]))
                answers.append(told[-1])
            problem = next((answer for answer in told if isinstance(answer, PolicyServerError)), None)
            if problem is not None:
                raise NotRun(f"the adapter does not answer what it was shown in a loop: {problem}")
    return answers
