"""XPL405: Observations are those of the standard."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.observations import problems
from xpl_cli.audit.environments.stage import Offer, Stage, motion


@rule(code="XPL405", gate="offline", requirement="XPL-ENV-3", after=("env-plays",))
def env_observations(stage: Stage) -> Iterator[Finding]:
    """An observation is not what the standard says: a value is missing, or has another shape, type, unit or range.

    ## What it does
    Looks at the first observation and at one after a step, for every task and for every robot with every action
    type: schema, dimensions of the robot, finite values, unit quaternions, gripper range, RGB pictures, cameras,
    instruction and index.

    ## Why it matters
    Policies read observations by these names and units. A gripper in metres, or a picture in BGR, is no error anywhere:
    it is a success rate that nobody can explain.

    ## Example
    The state has `ee_pose` with the quaternion's real part last.

    ## Use instead
    `xpl spec show observation` lists every key with its shape and unit.

    ## Fix safety
    No automatic fix.
    """
    for offer in stage.robots:
        yield from stage.told(_looked_at(stage, offer), f"{offer} can be observed")


def _looked_at(stage: Stage, offer: Offer) -> Iterator[Finding]:
    with stage.play(offer, cameras=stage.cameras) as play:
        play.reset(0)
        (first,) = play.observe()
        found = list(problems(stage, offer, first))
        if not found:
            play.act({0: motion(offer, first, 1)})
            found = list(problems(stage, offer, play.observe(0)[0]))
    for problem in found:
        yield stage.finding(
            f"{offer}: {problem}",
            expected="an observation of the standard",
            got=problem,
            advice="xpl spec show observation",
        )
