"""The facts there are, by name. A rule asks for one by naming a parameter after it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.audit.source import Source

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from xpl_cli.audit.advice import Remark
    from xpl_cli.audit.options import Options
    from xpl_cli.audit.probe import Probe
    from xpl_cli.audit.simulation import Simulation
    from xpl_cli.audit.waivers import Waiver


def all_providers() -> dict[str, Callable[..., Any]]:
    """Return every provider by the name of its fact.

    `path`, `kind`, `gate`, `options` and `checks` are given by the engine.
    """
    return {"source": source, "probe": probe, "simulation": simulation, "waivers": waivers, "ruff": ruff, "mypy": mypy}


def source(path: Path) -> Source:
    """The files of the adapter, parsed once, never executed."""
    return Source(path)


def waivers(source: Source) -> tuple[Waiver, ...]:
    """The findings that the adapter's manifest accepts."""
    from xpl_cli.audit.waivers import read

    return read(source)


def ruff(source: Source) -> tuple[Remark, ...]:
    """What ruff says about the adapter's own files."""
    from xpl_cli.audit.advice import ruff

    return ruff(source)


def mypy(source: Source) -> tuple[Remark, ...]:
    """What mypy says about the adapter's own files."""
    from xpl_cli.audit.advice import mypy

    return mypy(source)


def probe(path: Path, options: Options) -> Iterator[Probe]:
    """A real server and a real client, for the offline gate."""
    from xpl_cli.audit.probe import Probe

    with Probe.start(path, options) as started:
        yield started


def simulation(path: Path, options: Options) -> Iterator[Simulation]:
    """A real server driven by MuJoCo, for the MuJoCo gate."""
    from xpl_cli.audit.simulation import Simulation

    with Simulation.start(path, options) as started:
        yield started
