"""RoboTwin's own evaluation loop, against any object with the interface of its Base_Task.

Source: RoboTwin-Platform/RoboTwin, eval_remote_policy of scripts/eval_policy_xpolicylab.py at cf47ab5; a test plays
both side by side where a checkout is there. Differences: the wording of an instruction is drawn by the seed and not by
NumPy's global generator; a seed that is unstable after the expert has solved it is skipped and does not end the run;
and the search for seeds ends.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.client import ClientError
from xpl.embodiment import Embodiment

from . import convert

SEEDS = 100_000
"""Seeds of a run begin at SEEDS x (1 + its seed)."""
SEEN, UNSEEN = "seen", "unseen"
_ATTEMPTS = 50
UNSTABLE, EXPERT_RAISED, EXPERT_FAILED = "unstable", "expert_error", "expert_failed"


class Source(Protocol):
    """Where tasks come from: RoboTwin's own code, or a stand-in.

    Attributes:
        unstable: what a task raises where its objects do not come to rest.
        has_expert: whether the tasks' expert can solve seeds; a robot that stands in is none that it was written for.
    """

    unstable: type[Exception]
    has_expert: bool

    def make(self, task: str) -> Any:
        """Return the task: an object with the interface of Base_Task."""

    def arguments(self, task: str, setting: str) -> dict[str, Any]:
        """Return what its `setup_demo` takes besides."""

    def describe(self, task: str, info: Mapping[str, Any], count: int, seed: int) -> Mapping[str, list[str]]:
        """Return wordings of an episode's instruction, seen and unseen ones; the same for the same seed."""


@dataclass(frozen=True)
class EvalOptions:
    """What is played.

    Attributes:
        task, setting: RoboTwin's names.
        action_type: "joint" or "ee".
        seed: of the run.
        test_num: episodes that count.
        instruction_type: which wordings: seen or unseen.
        expert_check: whether seeds that the expert does not solve are skipped.
        frequency: as policies are told, Hz.
    """

    task: str
    setting: str = "demo_clean"
    action_type: str = "joint"
    seed: int = 0
    test_num: int = 100
    instruction_type: str = SEEN
    expert_check: bool = True
    frequency: float = 30


@dataclass
class EvalResult:
    """What came of it.

    Attributes:
        episodes: of each: seed, instruction, success, steps, and error, a sentence where the policy's side raised.
        skipped: seeds that do not count, with the reason.
    """

    episodes: list[dict[str, Any]] = field(default_factory=list)
    skipped: dict[int, str] = field(default_factory=dict)

    @property
    def rate(self) -> float:
        """Successes by episodes, as RoboTwin reports them."""
        won: int = sum(one["success"] for one in self.episodes)
        return won / len(self.episodes)


def evaluate(
    source: Source, client: Any, options: EvalOptions, robot: Embodiment, cameras: Mapping[str, Mapping[str, Any]]
) -> EvalResult:
    """Play seeds until enough episodes count.

    Args:
        source: where the task comes from.
        client: `call(func_name=..., obs=...)` runs an operation of the policy.
        options: what is played.
        robot: of the standard.
        cameras: those of env.yml.

    Raises:
        ClientError: the connection is lost; RoboTwin would count all that follow as failed.
        RuntimeError: so many seeds were skipped that there is something wrong.
    """
    task, played = source.make(options.task), EvalResult()
    arguments = {**source.arguments(options.task, options.setting), "eval_mode": True}
    seed = SEEDS * (1 + options.seed)
    last = seed + max(_ATTEMPTS * options.test_num, _ATTEMPTS)
    while len(played.episodes) < options.test_num:
        if seed == last:
            raise RuntimeError(
                f"of {len(played.skipped)} seeds {options.task} took {len(played.episodes)}: {_why(played)}"
            )
        info, reason = _checked(source, task, arguments, seed, len(played.episodes), options)
        if reason is None:
            reason = _set_up(source, task, {**arguments, "now_ep_num": len(played.episodes), spec.Deploy.SEED: seed})
        if reason is None:
            wordings = source.describe(options.task, info, options.test_num, seed).get(options.instruction_type)
            instruction = random.Random(seed).choice(wordings) if wordings else options.task  # noqa: S311 - words
            task.set_instruction(instruction=instruction)
            played.episodes.append(_episode(task, client, options, robot, cameras, seed))
            task.close_env()
        else:
            played.skipped[seed] = reason
        seed += 1
    return played


def _checked(  # noqa: PLR0913, PLR0917 - private
    source: Source, task: Any, arguments: Mapping[str, Any], seed: int, number: int, options: EvalOptions
) -> tuple[Mapping[str, Any], str | None]:
    """Return what the expert says of a seed, and why the seed does not count, or None."""
    if not options.expert_check:
        return {}, None
    try:
        task.setup_demo(now_ep_num=number, seed=seed, is_test=True, **{**arguments, "render_freq": 0})
        info, is_solved = ask_expert(source, task)
    except source.unstable:
        task.close_env()
        return {}, UNSTABLE
    except Exception:  # noqa: BLE001 - as RoboTwin: an expert may fail in any way
        task.close_env()
        return {}, EXPERT_RAISED
    task.close_env()
    return info, None if is_solved else EXPERT_FAILED


def ask_expert(source: Source, task: Any) -> tuple[Mapping[str, Any], bool]:
    """Let the expert of a task that is set up play; where it cannot, let it only tell.

    RoboTwin looks at the outcome after it has closed the task. The runtime's tasks have no robot any more by then, so
    that they are looked at before.

    Args:
        source: where the task is from.
        task: it.

    Returns:
        what the expert calls things, and whether it has solved the seed; where it only told, nothing has moved, and
        the seed counts.
    """
    if not source.has_expert:
        task.plan_success = False  # its moves do nothing once one of them has failed
    told = task.play_once()
    info: Mapping[str, Any] = (told or {}).get("info", {})
    if source.has_expert:
        return info, bool(task.plan_success and task.check_success())
    task.plan_success = True
    return info, True


def _set_up(source: Source, task: Any, arguments: Mapping[str, Any]) -> str | None:
    try:
        task.setup_demo(is_test=True, **arguments)
    except source.unstable:
        task.close_env()
        return UNSTABLE
    return None


def _episode(  # noqa: PLR0913, PLR0917 - private
    task: Any,
    client: Any,
    options: EvalOptions,
    robot: Embodiment,
    cameras: Mapping[str, Mapping[str, Any]],
    seed: int,
) -> dict[str, Any]:
    """Play one episode as RoboTwin does, and return what came of it."""
    case = {
        spec.Deploy.TASK_NAME: options.task,
        spec.Deploy.SEED: seed,
        spec.Obs.INSTRUCTION: task.get_instruction(),
        spec.Deploy.ACTION_TYPE: options.action_type,
    }

    def show() -> None:
        obs = convert.observation(
            task.get_obs(),
            cameras=cameras,
            robot=getattr(task, "robot", None),
            instruction=task.get_instruction(),
            frequency=options.frequency,
        )
        client.call(func_name=spec.Method.UPDATE_OBS, obs=obs)

    client.call(func_name=spec.Message.PREPARE_CASE, obs=dict(case))
    client.call(func_name=spec.Method.RESET, obs=dict(case))
    error = None
    try:
        while not _has_ended(task):
            show()
            chunk = client.call(func_name=spec.Method.GET_ACTION)
            if len(chunk) == 0:
                raise ActionError("the policy returned an empty chunk")  # noqa: TRY301 - told like all that it raises
            for index, action in enumerate(chunk):
                vector, kind = convert.command(action, robot, options.action_type)
                task.take_action(vector, action_type=kind)
                if _has_ended(task) or index + 1 == len(chunk):
                    break
                show()
    except Exception as raised:  # as RoboTwin: what the policy's side raises is a failure of the episode
        if isinstance(raised, ClientError) and raised.is_infrastructure_error:
            raise
        error = f"{type(raised).__name__}: {raised}"
    success = bool(task.eval_success)
    client.call(
        func_name=spec.Message.TRIAL_END,
        obs={spec.Deploy.TASK_NAME: options.task, spec.Deploy.SEED: seed, "success": success},
    )
    return {
        spec.Deploy.SEED: seed,
        spec.Obs.INSTRUCTION: case[spec.Obs.INSTRUCTION],
        "success": success,
        "steps": task.take_action_cnt,
        "error": error,
    }


def _has_ended(task: Any) -> bool:
    return bool(task.eval_success or task.take_action_cnt >= task.step_lim)


def _why(played: EvalResult) -> str:
    reasons = list(played.skipped.values())
    return ", ".join(f"{reasons.count(one)} {one}" for one in dict.fromkeys(reasons))
