"""XPL405: Observations conform to the standard."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer, motion
from xpl_cli.audit.environments.observations import problems


@rule(code="XPL405", gate="offline", requirement="XPL-ENV-3", after=("env-runs",), tries="observations")
def env_observations(env_probe: EnvProbe) -> Iterator[Finding]:
    """An observation does not conform to the standard: a value is missing, or has another shape, type, unit or range.

    ## What it does
    Checks the first observation and one after a step, for every task and for every robot with every action type:
    schema, dimensions of the robot, finite values, unit quaternions, gripper range, RGB images, cameras, instruction
    and index.

    ## Why it matters
    Policies rely on these names and units. A gripper in metres, or an image in BGR, causes no error, but a success rate
    that is hard to explain.

    ## Example
    The state has `ee_pose` with a quaternion in the order xyzw.

    ## Use instead
    `xpl spec show observation` lists every key with its shape and unit.

    ## Fix safety
    No automatic fix.
    """
    for offer in env_probe.robots:
        yield from env_probe.report_failure(_looked_at(env_probe, offer), f"{offer} can be observed")


def _looked_at(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer, cameras=env_probe.cameras) as play:
        play.reset(0)
        (first,) = play.observe()
        violations = list(problems(env_probe, offer, first))
        if not violations:
            play.act({0: motion(offer, first, 1)})
            violations = list(problems(env_probe, offer, play.observe(0)[0]))
    for problem in violations:
        yield env_probe.finding(
            f"{offer}: {problem}",
            expected="an observation of the standard",
            got=problem,
            advice="xpl spec show observation",
        )
