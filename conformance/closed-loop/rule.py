"""XPL301: A closed loop in physics breaks off."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.probe import blame
from xpl_cli.audit.simulation import ENVIRONMENT, STEPS, Simulation


@rule(code="XPL301", slug="closed-loop", gate="mujoco", requirement="XPL-SIM-1")
def closed_loop(simulation: Simulation) -> Iterator[Finding]:
    """A closed loop in physics breaks off.

    ## What it does
    Drives the adapter for some control steps in each task that fits its embodiment, with real observations of the
    simulator.

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
    for task in simulation.tasks():
        played = simulation.rollout(task)
        if played.problem is not None:
            yield blame(
                f"the closed loop of {task} breaks off after {played.steps} steps: {played.problem}",
                expected=f"{STEPS} control steps without an error",
                got=played.problem,
                evidence={"task": task, spec.Deploy.SEED: played.seeds[0], "steps": played.steps},
                fix=Fix("command", f"xpl eval {simulation.probe.package.path} --env {ENVIRONMENT} --task {task}"),
            )
