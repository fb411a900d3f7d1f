"""The providers of facts, by name. A rule requests a fact by naming a parameter after it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.audit.static.source import Source

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from xpl_cli.audit.environments.env_probe import EnvProbe
    from xpl_cli.audit.rules.facts import Provider
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.rules.profiles import ServedProfile
    from xpl_cli.audit.served.probe import Probe


def all_providers() -> Mapping[str, Provider]:
    """Return every provider by the name of its fact; one that is a path is imported when a rule requests its fact.

    The engine adds `path`, `kind`, `gate`, `options` and `checks`.
    """
    audit = "xpl_cli.audit"
    return {
        "configurations": f"{audit}.offline.configurations:Configurations",
        "demonstrations": f"{audit}.offline.demonstrations.fact:DemonstrationComparison",
        "in_process_run": f"{audit}.offline.in_process_run:run_in_process",
        "motions": f"{audit}.offline.motion:MotionEpisodes",
        "mypy": f"{audit}.static.linters:mypy",
        "parity": f"{audit}.offline.parity.fact:Parity",
        "probe": probe,
        "profile": profile,
        "ruff": f"{audit}.static.linters:ruff",
        "semantics": f"{audit}.offline.semantics:Semantics",
        "service": f"{audit}.served.service:ServiceRun.of",
        "simulation": f"{audit}.physics.simulation:Simulation",
        "source": source,
        "env_probe": env_probe,
        "waivers": f"{audit}.engine.waivers:read",
    }


def source(path: Path, options: AuditOptions) -> Source:
    """The files of the adapter, parsed once, never executed."""
    return Source(path, options.variant)


def probe(path: Path, options: AuditOptions) -> Iterator[Probe]:
    """A real server and a real client."""
    from xpl_cli.audit.served.probe import Probe

    with Probe.start(path, options) as started:
        yield started


def profile(probe: Probe) -> ServedProfile:
    """What the gate runs on: the real model, or a shadow of it."""
    return probe.profile


def env_probe(path: Path, options: AuditOptions) -> Iterator[EnvProbe]:
    """An environment that runs in a separate process."""
    from xpl_cli.audit.environments.env_probe import EnvProbe

    probe = EnvProbe(path, options)
    try:
        yield probe
    finally:
        probe.close()
