"""Whether a policy acts on the newest observation: a rollout is replayed to it, with single observations changed.

The observations are recorded in a rollout, and do not depend on the actions in the replay: so a change of an action is
an effect of the changed observation.
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
    from xpl_cli.audit.physics.rollout import RecordedObservations
    from xpl_cli.audit.physics.simulation import Simulation
    from xpl_cli.audit.served.recorded_client import Answer

_CONSTANT = (sdk.Obs.INSTRUCTION, sdk.Obs.PRIVILEGED)
"""Inputs that are constant in an episode, or whose form the standard does not define."""
_TRIED = (1, 2, 3)
"""Inferences before which an observation is changed; the first one has none before it."""


@dataclass(frozen=True)
class Reaction:
    """The effects of changing one observation, as fractions of the range of all actions.

    Attributes:
        inference: index of the inference before which an observation was changed.
        newest: effect on its action, with the newest observation changed.
        older: the same, with the observation one step before changed; None if another inference used that one.
        late: effect on the action of the next inference, with the newest observation of this one changed.
    """

    inference: int
    newest: float
    older: float | None
    late: float

    @property
    def before(self) -> float:
        """The effect of an observation that is not the newest one."""
        return max(self.late, self.older or 0.0)

    @property
    def lags(self) -> bool:
        """Whether the action depends on an older observation than the newest one."""
        return is_weak(self.newest, self.before)


def reactions(simulation: Simulation) -> list[Reaction]:
    """Return a policy's reactions, up to the first action that depends on the newest observation.

    Raises:
        NotApplicable: if no input can be changed, or no action depends on one.
        NotRun: if the same observations give different actions.
    """
    recorded = simulation.record_observations(max(_TRIED) + 2)
    names = _changeable(simulation, recorded.observations[0])
    if len(recorded.inference_steps) <= _TRIED[0] + 1:
        raise NotApplicable("the rollout has too few chunks")
    usual = _replay(simulation, recorded, recorded.observations)
    if not same(usual, _replay(simulation, recorded, recorded.observations)):
        raise NotRun("the same observations give different actions, which same-seed-same-motion reports")
    results = []
    for inference in [number for number in _TRIED if number + 1 < len(recorded.inference_steps)]:
        step = recorded.inference_steps[inference]
        changed = _replay(simulation, recorded, _with_change(recorded, step, names))
        before = None
        if step - 1 not in recorded.inference_steps:
            before = _replay(simulation, recorded, _with_change(recorded, step - 1, names))
        scale = Scale([*usual, *changed, *(before or ())])
        newest, late = (scale.effect(usual[index], changed[index]) for index in (inference, inference + 1))
        older = None if before is None else scale.effect(usual[inference], before[inference])
        results.append(Reaction(inference, newest, older, late))
        if not results[-1].lags and newest:
            break
    if not any(reaction.newest or reaction.before for reaction in results):
        raise NotApplicable("no action in the middle of the rollout depends on its observations")
    return results


def _changeable(simulation: Simulation, obs: ObservationDict) -> list[str]:
    present = changed_inputs.present(obs)
    names = [name for name in simulation.probe.required or present if name in present and name not in _CONSTANT]
    if not names:
        raise NotApplicable("the manifest requires no input that changes in an episode and can be changed by an audit")
    return names


def _with_change(recorded: RecordedObservations, step: int, names: Sequence[str]) -> tuple[ObservationDict, ...]:
    obs = recorded.observations[step]
    for name in names:
        obs = changed_inputs.varied(obs, name)
    return (*recorded.observations[:step], obs, *recorded.observations[step + 1 :])


def _replay(
    simulation: Simulation, recorded: RecordedObservations, observations: Sequence[ObservationDict]
) -> list[Answer]:
    """Send observations one after the other and return the actions.

    Raises:
        NotRun: if the policy raises an error.
    """
    answers = []
    with simulation.comparable_session() as policy:
        policy.reset()
        for step, obs in enumerate(observations[: recorded.inference_steps[-1] + 1]):
            replies = [policy.update_obs_batch([obs])]
            if step in recorded.inference_steps:
                replies.append(policy.get_action_batch([obs[sdk.Obs.ENV_IDX]]))
                answers.append(replies[-1])
            problem = next((answer for answer in replies if isinstance(answer, PolicyServerError)), None)
            if problem is not None:
                raise NotRun(f"the adapter fails on observations of a rollout: {problem}")
    return answers
