"""Run all probes at once; together they take as long as the slowest."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

from xpl_cli.lifecycle.doctor import machine, programs
from xpl_cli.lifecycle.doctor.check import MachineCheck, Status

if TYPE_CHECKING:
    from collections.abc import Callable

_PROBES: dict[str, Callable[[], MachineCheck]] = {
    "xpl": machine.tool,
    "python": programs.interpreters,
    "uv": programs.uv,
    "conda": programs.conda,
    "git": programs.git,
    "docker": programs.docker,
    "gpu": programs.gpu,
    "egl": partial(programs.rendering, "egl"),
    "osmesa": partial(programs.rendering, "osmesa"),
    "isolation": machine.isolation,
    "shared memory": machine.shared_memory,
    "memory": machine.memory,
    "cores": machine.cores,
    "disk": machine.disk,
    "ports": machine.ports,
    "hub": machine.hub,
}


def examine() -> list[MachineCheck]:
    """Return what this machine can run, in a fixed order."""
    with ThreadPoolExecutor(max_workers=len(_PROBES)) as pool:
        return list(pool.map(lambda item: _guarded(*item), _PROBES.items()))


def _guarded(name: str, probe: Callable[[], MachineCheck]) -> MachineCheck:
    """Return the result of a probe, also if it raises."""
    try:
        return probe()
    except Exception as error:  # noqa: BLE001 - machines differ in unforeseen ways
        return MachineCheck(name, Status.BROKEN, f"could not be tested: {type(error).__name__}: {error}", "unknown")
