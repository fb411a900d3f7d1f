"""RoboTwin's own evaluation loop, for any object with the interface of its Base_Task.

Source: RoboTwin-Platform/RoboTwin, eval_remote_policy of scripts/eval_policy_xpolicylab.py at cf47ab5; a test runs
both side by side if there is a checkout. Differences: the wording of an instruction is drawn by the seed and not by
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
    """The source of tasks: RoboTwin's own code, or a mock.

    Attributes:
        unstable: exception of a task whose objects do not come to rest.
        has_expert: whether the tasks' expert can solve seeds; it was not written for the mock robot.
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
    """Options of an evaluation.

    Attributes:
        task, setting: RoboTwin's names.
        action_type: "joint" or "ee".
        seed: of the run.
        test_num: episodes that count.
        instruction_type: which wordings: seen or unseen.
        expert_check: whether to skip seeds that the expert does not solve.
        frequency: that policies get, Hz.
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
    """The result of an evaluation.

    Attributes:
        episodes: of each: seed, instruction, success, steps, and error, a sentence if the policy's side raised.
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
    """Run seeds until enough episodes count.

    Args:
        source: of the task.
        client: `call(func_name=..., obs=...)` runs an operation of the policy.
        options: of the evaluation.
        robot: of the standard.
        cameras: those of env.yml.

    Raises:
        ClientError: the connection is lost; RoboTwin would count all that follow as failed.
        RuntimeError: too many seeds were skipped.
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
        info, reason = _check_seed(source, task, arguments, seed, len(played.episodes), options)
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


def _check_seed(  # noqa: PLR0913, PLR0917 - private
    source: Source, task: Any, arguments: Mapping[str, Any], seed: int, number: int, options: EvalOptions
) -> tuple[Mapping[str, Any], str | None]:
    """Return the expert's information on a seed, and why the seed does not count, or None."""
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
    """Let the expert of a task run; without a robot, let it only name objects.

    RoboTwin reads the outcome after it has closed the task. The runtime's tasks have no robot any more by then, so that
    their outcome is read before.

    Args:
        source: of the task.
        task: the task, set up.

    Returns:
        names of objects, and whether the expert has solved the seed; if it only named objects, nothing has moved, and
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
    """Run one episode as RoboTwin does, and return its result."""
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
                raise ActionError("the policy returned an empty chunk")  # noqa: TRY301 - reported like its other errors
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
