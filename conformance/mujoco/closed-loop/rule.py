"""XPL301: A rollout in physics ends with an error."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.rules.measurements import ENVIRONMENT
from xpl_cli.audit.served.probe import blame


@rule(code="XPL301", requirement="XPL-SIM-1", tries="whole rollouts")
def closed_loop(simulation: Simulation) -> Iterator[Finding]:
    """A rollout in physics ends with an error.

    ## What it does
    Runs the adapter for some chunks with every robot and action type that its manifest declares and the environment
    supports, with real observations of the simulator. Every rollout has to end by success or by the step limit, not by
    an error, an action that is not finite or a state that diverges.

    ## Why it matters
    Scripted observations do not cover everything: in a rollout grippers never close fully, objects leave the view, and
    states drift. What fails here fails in every benchmark.

    ## Example
    An action queue that is empty after its first chunk, so that `get_action` returns an empty list.

    ## Use instead
    Run the command of the finding; it shows the adapter's traceback.

    ## Fix safety
    No automatic fix.
    """
    for played in simulation.rollouts():
        course = played.setup
        if played.problem is not None:
            pair = {spec.Deploy.ENV_CFG_TYPE: course.embodiment, spec.Deploy.ACTION_TYPE: course.action_type}
            settings = [part for key, value in pair.items() for part in ("--set", f"{key}={value}")]
            command = ["xpl", "eval", str(simulation.probe.package.path), "--env", ENVIRONMENT, "--task", course.task]
            yield blame(
                f"the rollout of {course} fails after {played.steps} steps: {played.problem}",
                expected="an episode that ends by success or by the step limit",
                got=played.problem,
                evidence={"task": course.task, spec.Deploy.SEED: played.seeds[0], "steps": played.steps},
                fix=Fix("command", shlex.join([*command, *settings])),
            )
