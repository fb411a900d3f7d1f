"""The facts there are, by name. A rule asks for one by naming a parameter after it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.audit.static.source import Source

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from xpl_cli.audit.engine.waivers import Waiver
    from xpl_cli.audit.environments.stage import Stage
    from xpl_cli.audit.offline.configurations import Configurations
    from xpl_cli.audit.offline.demonstrations.fact import Demonstrated
    from xpl_cli.audit.offline.motion import Motions
    from xpl_cli.audit.offline.parity.fact import Parity
    from xpl_cli.audit.offline.rehearsal import Rehearsal
    from xpl_cli.audit.offline.semantics import Semantics
    from xpl_cli.audit.physics.simulation import Simulation
    from xpl_cli.audit.rules.options import Options
    from xpl_cli.audit.rules.profiles import Choice
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.audit.served.service import Service
    from xpl_cli.audit.static.advice import Remark


def all_providers() -> dict[str, Callable[..., Any]]:
    """Return every provider by the name of its fact.

    `path`, `kind`, `gate`, `options` and `checks` are given by the engine.
    """
    return {
        "configurations": configurations,
        "demonstrations": demonstrations,
        "motions": motions,
        "mypy": mypy,
        "parity": parity,
        "probe": probe,
        "profile": profile,
        "rehearsal": rehearsal,
        "ruff": ruff,
        "semantics": semantics,
        "service": service,
        "simulation": simulation,
        "source": source,
        "stage": stage,
        "waivers": waivers,
    }


def source(path: Path, options: Options) -> Source:
    """The files of the adapter, parsed once, never executed."""
    return Source(path, options.variant)


def waivers(source: Source) -> tuple[Waiver, ...]:
    """The findings that the adapter's manifest accepts."""
    from xpl_cli.audit.engine.waivers import read

    return read(source)


def ruff(source: Source) -> tuple[Remark, ...]:
    """What ruff says about the adapter's own files."""
    from xpl_cli.audit.static.advice import ruff

    return ruff(source)


def mypy(source: Source) -> tuple[Remark, ...]:
    """What mypy says about the adapter's own files."""
    from xpl_cli.audit.static.advice import mypy

    return mypy(source)


def probe(path: Path, options: Options) -> Iterator[Probe]:
    """A real server and a real client."""
    from xpl_cli.audit.served.probe import Probe

    with Probe.start(path, options) as started:
        yield started


def profile(probe: Probe) -> Choice:
    """What the gate runs on: the real model, or a shadow of it."""
    return probe.profile


def rehearsal(probe: Probe) -> Rehearsal:
    """What the adapter does in one process without a server, where what a client cannot see can be seen."""
    from xpl_cli.audit.offline.rehearsal import rehearse

    probe.ready()
    return rehearse(probe)


def parity(probe: Probe) -> Parity:
    """What the adapter answers to the questions of its native pairs."""
    from xpl_cli.audit.offline.parity.fact import Parity

    return Parity(probe)


def demonstrations(probe: Probe) -> Demonstrated:
    """What the adapter answers in recorded episodes."""
    from xpl_cli.audit.offline.demonstrations.fact import Demonstrated

    return Demonstrated(probe)


def stage(path: Path, options: Options) -> Iterator[Stage]:
    """An environment, played in a process of its own."""
    from xpl_cli.audit.environments.stage import Stage

    opened = Stage(path, options)
    try:
        yield opened
    finally:
        opened.close()


def simulation(probe: Probe) -> Simulation:
    """A real server driven by MuJoCo, for the MuJoCo gate."""
    from xpl_cli.audit.physics.simulation import Simulation

    return Simulation(probe)


def semantics(probe: Probe) -> Semantics:
    """What the actions depend on, for the offline gate."""
    from xpl_cli.audit.offline.semantics import Semantics

    return Semantics(probe)


def motions(probe: Probe) -> Motions:
    """A short episode with every declared robot and action type, for the offline gate."""
    from xpl_cli.audit.offline.motion import Motions

    return Motions(probe)


def configurations(probe: Probe, service: Service) -> Configurations:
    """The adapter under other values of deploy.yml."""
    from xpl_cli.audit.offline.configurations import Configurations

    return Configurations(probe, service)


def service(probe: Probe) -> Service:
    """One server of the adapter from its start to its end, with the processes that it had."""
    from xpl_cli.audit.served.service import Service

    return Service.of(probe)
