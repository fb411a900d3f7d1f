"""XPL301: A closed loop in physics breaks off."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.audit.rules.figures import ENVIRONMENT
from xpl_cli.audit.served.probe import blame


@rule(code="XPL301", requirement="XPL-SIM-1")
def closed_loop(simulation: Simulation) -> Iterator[Finding]:
    """A closed loop in physics breaks off.

    ## What it does
    Drives the adapter for some chunks with every robot and action type that its manifest declares and the environment
    offers, with real observations of the simulator. Every loop has to come to its own end: by success or by the step
    limit, not by an error, an action that is not finite or a state that explodes.

    ## Why it matters
    Scripted observations do not show everything: a loop meets grippers that never close fully, objects out of view, and
    states that drift. What breaks here breaks every benchmark run.

    ## Example
    An action queue that is exhausted after its first chunk and then returns an empty list.

    ## Use instead
    Run the command of the finding; it shows the adapter's traceback.

    ## Fix safety
    No automatic fix.
    """
    for played in simulation.rollouts():
        course = played.course
        if played.problem is not None:
            pair = {spec.Deploy.ENV_CFG_TYPE: course.embodiment, spec.Deploy.ACTION_TYPE: course.action_type}
            settings = [part for key, value in pair.items() for part in ("--set", f"{key}={value}")]
            command = ["xpl", "eval", str(simulation.probe.package.path), "--env", ENVIRONMENT, "--task", course.task]
            yield blame(
                f"the closed loop of {course} breaks off after {played.steps} steps: {played.problem}",
                expected="an episode that ends by success or by the step limit",
                got=played.problem,
                evidence={"task": course.task, spec.Deploy.SEED: played.seeds[0], "steps": played.steps},
                fix=Fix("command", shlex.join([*command, *settings])),
            )
