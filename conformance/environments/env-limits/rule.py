"""XPL413: Actions beyond the robot's limits are clamped and reported."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as sdk
from xpl.contract import Observation
from xpl.simulator.process import EnvRaisedError
from xpl_cli.audit import Finding, NotApplicable, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer, RunningEnv, motion

GIVE = 0.05  # rad, and part of the gripper's range: what a simulated joint may give at its stop


@rule(code="XPL413", gate="offline", requirement="XPL-ENV-12", after=("env-runs",), tries="commands beyond the limits")
def env_limits(env_probe: EnvProbe) -> Iterator[Finding]:
    """A guarded environment executes an action beyond its robot's limits, or silently another action.

    ## What it does
    In an environment that declares `guarded`: commands joints one radian beyond their limits, a gripper at 2 and a
    quaternion of length 3. Each has to be refused, or reported in the result of `take_action_batch`, and the state has
    to stay within limits. Then sends NaN: the episode ends, or the action is refused, and the state stays finite.

    ## Why it matters
    Evaluation does not supervise an environment that declares itself guarded. Silent clamping hides a policy whose
    units are wrong.

    ## Example
    `guarded = True` on a simulator that clamps nothing.

    ## Use instead
    Report in `corrections`, by arm prefix, what was changed; or leave `guarded` out, and `xpl eval` supervises.
    `xpl.environment.Environment`, which implements this for an author's `Episode`.

    ## Fix safety
    No automatic fix.
    """
    if env_probe.manifest.scripted:
        raise NotApplicable("env.yml declares that observations follow a script: there is no robot to protect")
    for offer in _of_each_kind(env_probe):
        yield from env_probe.report_failure(_bounded(env_probe, offer), f"{offer} handles wrong commands")


def _of_each_kind(env_probe: EnvProbe) -> list[Offer]:
    return list({offer.action_type: offer for offer in reversed(env_probe.tasks)}.values())


def _bounded(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer) as play:
        if not play.guarded:
            raise NotApplicable("the environment does not declare itself guarded: evaluation supervises it")
        for what, change in _beyond(offer):
            play.reset(0)
            (first,) = play.observe()
            got = _reported(play, motion(offer, first, 0) | change) or _outside(offer, play.observe(0)[0])
            if got is not None:
                yield env_probe.finding(
                    f"{offer}: {what} {got}",
                    expected="a refusal, or a correction in the report, and a state within limits",
                    got=got,
                    advice="clamp it, and report it in corrections; xpl.safety.Supervisor does both",
                )
        play.reset(0)
        (first,) = play.observe()
        got = _after_nan(play, {key: value * np.float32("nan") for key, value in motion(offer, first, 0).items()})
        if got is not None:
            yield env_probe.finding(
                f"{offer}: an action of NaN {got}",
                expected="a refusal, or the end of the episode, and a finite state",
                got=got,
                advice="check for values that are not finite before the simulator gets them",
            )


def _beyond(offer: Offer) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    arm = offer.robot.arms[0]
    keys = offer.robot.dims(offer.action_type)
    joints, gripper = arm.prefix + sdk.State.ARM_JOINT_STATE, arm.prefix + sdk.State.EE_JOINT_STATE
    if joints in keys and arm.upper is not None:
        yield "a command one radian beyond the joints' limits", {joints: (arm.upper + 1).astype(np.float32)}
    if arm.prefix + sdk.State.EE_POSE in keys:
        pose = np.array([0.3, 0.1, 0.9, 3.0, 0.0, 0.0, 0.0], dtype=np.float32)
        yield "a quaternion of length 3", {arm.prefix + sdk.State.EE_POSE: pose}
    if arm.gripper == "parallel_gripper":
        yield "a gripper commanded to 2", {gripper: np.array([2.0], dtype=np.float32)}


def _reported(play: RunningEnv, action: dict[str, np.ndarray]) -> str | None:
    try:
        (report,) = play.act({0: action}) or [None]
    except EnvRaisedError:
        return None
    corrections = report.get("corrections") if isinstance(report, dict) else None
    return None if corrections else f"is executed without a report: corrections are {report!r}"


def _outside(offer: Offer, obs: Observation) -> str | None:
    state, arm = obs[sdk.Obs.STATE], offer.robot.arms[0]
    joints = state.get(arm.prefix + sdk.State.ARM_JOINT_STATE)
    opening = state.get(arm.prefix + sdk.State.EE_JOINT_STATE)
    if joints is not None and arm.lower is not None and arm.upper is not None:
        past = float(np.maximum(arm.lower - joints, joints - arm.upper).max())
        if past > GIVE:
            return f"brings the joints {past:.2g} rad beyond their limits"
    if opening is not None and arm.gripper == "parallel_gripper" and not -GIVE <= float(opening[0]) <= 1 + GIVE:
        return f"brings the gripper to {float(opening[0]):.2g}"
    return None


def _after_nan(play: RunningEnv, action: dict[str, np.ndarray]) -> str | None:
    try:
        play.act({0: action})
        if play.running():
            return "is executed, and the episode continues"
    except EnvRaisedError:
        pass
    state = play.observe(0)[0][sdk.Obs.STATE]
    broken = [key for key, value in state.items() if not np.isfinite(np.asarray(value, dtype=np.float64)).all()]
    return f"reaches the state: {', '.join(broken)}" if broken else None
