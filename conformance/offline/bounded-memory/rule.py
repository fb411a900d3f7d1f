"""XPL223: The memory of an episode grows with every step."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.memory import long_episode
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.basics.phrases import count_noun


@rule(code="XPL223", requirement="XPL-EPI-6", tries="long episodes and histories")
def bounded_memory(probe: Probe) -> Iterator[Finding]:
    """The memory of an episode grows with every step.

    ## What it does
    Runs one long episode with large images and measures the memory of the adapter's processes after every series of
    steps. If it still grows by a sizeable part of an observation per step after several series, it is not bounded.

    ## Why it matters
    Episodes on robots last for hours. A list of all observations ends them when the memory is full, and slows them down
    long before.

    ## Example
    `self.frames.append(obs)` with `self.frames[-2:]` read.

    ## Use instead
    `collections.deque(maxlen=history)`, or the history that `xpl.Policy` keeps.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    played = long_episode(probe)
    if played is None:
        raise NotApplicable("this operating system does not report the memory of a process")
    if played.per_step is None and not played.would_show:
        steps = played.stretches[-1][0] if played.stretches else 0
        raise NotApplicable(
            f"{count_noun(steps, 'step')} took as long as a stretch may last: memory for observations of "
            f"{played.observation / 1e3:.0f} kB would not be noticed"
        )
    if played.per_step is not None:
        kept, size = played.per_step / 1e3, played.observation / 1e3
        yield blame(
            f"memory grows by {kept:.0f} kB with every step of an episode, of observations of {size:.0f} kB: a long "
            f"episode ends when the memory is full, {played.per_step * 1e4 / 1e9:.1f} GB after 10,000 steps",
            expected="memory that stays the same after the first steps",
            got=", ".join(f"{grown / 1e6:+.1f} MB in {steps} steps" for steps, grown in played.stretches),
            evidence={"steps": sum(steps for steps, _ in played.stretches), "bytes_per_step": round(played.per_step)},
            fix=Fix("advice", "keep no more than the declared history, in a deque with maxlen"),
        )
