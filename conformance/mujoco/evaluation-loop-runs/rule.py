"""XPL312: The adapter's own evaluation loop does not run an episode to its end."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.physics.evaluation_loop import adapter_loop, run_loop
from xpl_cli.audit.physics.simulation import Simulation
from xpl_cli.standard import spec


@rule(code="XPL312", requirement="XPL-SIM-12", tries="the loop of deploy.py")
def evaluation_loop_runs(simulation: Simulation) -> Iterator[Finding]:
    """The adapter's own evaluation loop does not run an episode to its end.

    ## What it does
    Runs the loops of `deploy.py` in physics: one episode that ends in the middle of a chunk, and a batch of two that
    end one after the other. Each loop has to run until the environment reports the end of the episode, and no further.

    ## Why it matters
    Benchmarks run these loops. One that returns early measures unfinished episodes; one that continues commands a robot
    whose episode has ended, or never returns.

    ## Example
    `for _ in range(100): ...` in place of a check of `is_episode_end()`.

    ## Use instead
    The loops that `xpl new-policy` writes.

    ## Fix safety
    No automatic fix.
    """
    probe = simulation.probe
    with adapter_loop(probe.package.path, probe.options) as loop:
        for batch, name in enumerate(spec.data("package")["loop"]["functions"]):
            with simulation.shortened_env(2 if batch else 1) as (stage, session):
                problem = run_loop(loop, stage, session, batch=bool(batch))
            if problem is not None:
                yield Finding(
                    f"in physics {name} {problem}",
                    path=sdk.File.DEPLOY_PY,
                    expected="an episode that runs until the environment reports its end",
                    got=f"{stage.steps} of {list(stage.lengths)} control steps, and {stage.late} after the end",
                    evidence={"task": simulation.first.task},
                    fix=Fix("advice", "check is_episode_end() or get_running_env_idx_list() after every action"),
                )
