"""Memory of an adapter's processes, and whether it grows during a long episode."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import Client
from xpl import _spec as sdk
from xpl.client import ClientError
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.served.hanging import bounded_timeouts
from xpl_cli.audit.served.servers import PATIENCE
from xpl_cli.isolation import processes

if TYPE_CHECKING:
    from xpl.contract import ObservationDict
    from xpl_cli.audit.served.probe import Probe

_ENLARGED = 3
"""Factor of the image sides, so that a retained observation stands out from Python's own allocations."""
_STEPS, _SECONDS = 30, 3.0
"""A stretch ends after so many steps, or so much time where a model is slow."""
_STRETCHES = 5
_LEAST = 1_000_000
"""Bytes in a stretch that are no accident of an allocator."""
_WARM = 2
"""Histories that are filled before the first look."""


@dataclass(frozen=True)
class LongEpisode:
    """Memory growth during a long episode.

    Attributes:
        observation: size of one observation, bytes.
        stretches: for each, its steps and the growth, bytes.
        per_step: bytes that every step added to the end, or None where memory came to rest.
    """

    observation: int
    stretches: tuple[tuple[int, int], ...]
    per_step: float | None

    @property
    def would_show(self) -> bool:
        """Whether observations that are kept would have added noticeable memory in the last stretch."""
        return bool(self.stretches) and self.stretches[-1][0] * self.observation >= _LEAST


def long_episode(probe: Probe) -> LongEpisode | None:
    """Run one episode until the adapter's memory stays constant, or has grown in every stretch.

    Returns:
        None where the system does not tell what memory a process uses.

    Raises:
        NotRun: if the adapter does not come through the episode.
    """
    server = probe.server()
    if private_memory(server.pid) is None:
        return None
    try:
        # Through shared memory what an adapter keeps would lie in the client's memory for a while. Off the record: how
        # many steps are played depends on the machine.
        with Client(
            server.url, config=probe.config | bounded_timeouts(probe.config) | PATIENCE, shared_memory=False
        ) as policy:
            return _measure_stretches(probe, policy, server.pid)
    except ClientError as error:
        raise NotRun(f"a long episode does not come to its end: {error}") from None


def _measure_stretches(probe: Probe, policy: Client, pid: int) -> LongEpisode:
    """Run stretches of one episode until one adds no memory."""
    history = probe.package.manifest.temporal.history
    size = _size(_enlarged(probe, probe.observation()))
    stretches: list[tuple[int, int]] = []
    policy.reset()
    step = _run_stretch(probe, policy, 0, max(_STEPS, _WARM * history))
    before = private_memory(pid) or 0
    for _ in range(_STRETCHES):
        played = _run_stretch(probe, policy, step, _STEPS)
        step += played
        now = private_memory(pid) or 0
        stretches.append((played, now - before))
        before = now
        if stretches[-1][1] < _LEAST:
            return LongEpisode(size, tuple(stretches), None)
    return LongEpisode(size, tuple(stretches), min(grown / steps for steps, grown in stretches))


def private_memory(pid: int) -> int | None:
    """Return the memory that the children of a process, and theirs, have for themselves, bytes; None if unknown."""
    sizes = [processes.private_bytes(member.pid) for member in processes.descendants(pid)]
    known_sizes = [size for size in sizes if size is not None]
    return sum(known_sizes) if known_sizes else None


def _run_stretch(probe: Probe, policy: Client, first: int, most: int) -> int:
    """Continue the episode for one stretch, and return its number of steps."""
    deadline = time.monotonic() + _SECONDS
    for steps in range(1, most + 1):
        policy.update_obs(_enlarged(probe, probe.observation(0, first + steps)))
        policy.get_action()
        if time.monotonic() > deadline:
            break
    return steps


def _enlarged(probe: Probe, obs: ObservationDict) -> ObservationDict:
    """Return an observation with larger images, but for cameras whose images have one size only."""
    needs = probe.package.manifest.cameras
    vision = dict(obs[sdk.Obs.VISION])
    for name, camera in obs[sdk.Obs.VISION].items():
        if (needed := needs.get(name)) is not None and needed.exact:
            continue
        larger = {
            key: np.repeat(np.repeat(camera[key], _ENLARGED, axis=0), _ENLARGED, axis=1)
            for key in (sdk.Camera.COLOR, sdk.Camera.DEPTH)
        }
        larger[sdk.Camera.SHAPE] = np.array(larger[sdk.Camera.COLOR].shape[:2])
        vision[name] = {**camera, **larger}
    return {**obs, sdk.Obs.VISION: vision}


def _size(obs: ObservationDict) -> int:
    return sum(value.nbytes for camera in obs[sdk.Obs.VISION].values() for value in camera.values())
