"""XPL310: In a rollout the robot waits for the policy."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.physics.rollout import PhysicsRollout
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.served.probe import blame

_RATE = "control_frequency"


@rule(code="XPL310", requirement="XPL-SIM-10", profile="full", tries="control rates")
def control_rate(simulation: Simulation) -> Iterator[Finding]:
    """In a rollout the robot waits for the policy.

    ## What it does
    Adds up, for each chunk of a rollout, the time of `update_obs`, between the control steps too, and of `get_action`,
    with observations of the simulator. The median of each rollout is compared with the duration of the chunk at the
    control frequency that the manifest declares, or else at that of the environment.

    ## Why it matters
    `inference-rate` measures one inference. In a rollout the policy gets an observation at every step, with images of
    their real size, and a policy whose memory grows takes longer with every step. On hardware the arm stands still
    meanwhile.

    ## Example
    A vision encoder in `update_obs`, which runs sixteen times for each chunk of sixteen steps.

    ## Use instead
    Store observations unchanged in `update_obs` and encode in `get_action` what it needs, or declare the rate that the
    policy can keep.

    ## Fix safety
    No automatic fix.
    """
    rate = simulation.probe.package.manifest.control_frequency or simulation.frequency
    times = [(played, interval) for played in simulation.sound_rollouts() if (interval := _middle(played)) is not None]
    if not times:
        raise NotApplicable("no chunk was executed to its end besides the first")
    slow = [(played, waits, lasts / rate) for played, (waits, lasts) in times if waits > lasts / rate]
    if slow:
        played, waits, lasts = max(slow, key=lambda entry: entry[1] / entry[2])
        yield blame(
            f"in {played.setup} update_obs and get_action take {1e3 * waits:.0f} ms for a chunk that lasts "
            f"{1e3 * lasts:.0f} ms at {rate:g} Hz: the robot waits",
            expected=f"less than {1e3 * lasts:.0f} ms",
            got=f"{1e3 * waits:.0f} ms",
            fix=Fix("advice", f"do less for each observation, or declare a {_RATE} that can be kept"),
        )


def _middle(played: PhysicsRollout) -> tuple[float, float] | None:
    """Return the middle time of a chunk, s, and its steps; the first chunk and one that was cut short do not count."""
    queries, steps = played.inferences[0], len(played.commands[0])
    whole = [query for query in queries[1:] if query.step + len(query.chunk) <= steps]
    if not whole:
        return None
    return median(query.seconds for query in whole), median(len(query.chunk) for query in whole)
