"""Many clients at once, asking a model whose forward pass costs 20 ms and 1 ms per observation: does it get batches?"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from benchmarks.serving_bench import processes
from benchmarks.serving_bench.latency import percentile
from benchmarks.serving_bench.model import Model

if TYPE_CHECKING:
    from benchmarks.serving_bench.contenders import Contender

MODEL = Model(fixed_ms=20, sample_ms=1)
PAYLOAD = "state"
CLIENT_PROCESSES = 2
"""Clients share so many processes, a thread each: 32 interpreters would take the processor from the server."""
CONNECT_S = 30.0
MARGIN_S = 60.0


def run(running: Sequence[tuple[Contender, str]], seconds: float, clients: Sequence[int]) -> list[dict[str, Any]]:
    """Measure every contender that serves several clients, each of which asks again as soon as it is answered.

    Args:
        running: contenders with the interpreters of their environments.
        seconds: length of a measurement, s.
        clients: numbers of clients.

    Returns:
        One row per contender and number of clients: `per_s` inferences, `p50_ms`, `p99_ms`; or `failed` and why.
    """
    rows = []
    for count in clients:
        for contender, python in running:
            if contender.concurrent is None:
                continue
            # Alone, also as it is when it does not prepare for company: what does the preparation cost?
            settings = {contender.concurrent, contender.setting} if count == 1 else {contender.concurrent}
            for setting in sorted(settings):
                print(f"throughput: {contender.name}, clients: {count}", file=sys.stderr)
                row = {"contender": contender.name, "setting": setting, "clients": count}
                try:
                    rows.append(row | _measure(contender, python, setting.format(clients=count), count, seconds))
                except processes.EndError as error:
                    rows.append(row | {"failed": str(error)})
    return rows


def _measure(contender: Contender, python: str, setting: str, count: int, seconds: float) -> dict[str, Any]:
    shares = [len(range(start, count, CLIENT_PROCESSES)) for start in range(min(count, CLIENT_PROCESSES))]
    with ExitStack() as stack:
        server = stack.enter_context(processes.server(python, contender.module, setting, MODEL))
        arguments = (python, contender.module, setting, server.first["address"])
        crowds = [stack.enter_context(processes.crowd(*arguments)) for _ in shares]
        for crowd, share in zip(crowds, shares, strict=True):
            crowd.order(CONNECT_S, payload=PAYLOAD, clients=share)
        for crowd in crowds:
            crowd.send(seconds=seconds)
        answers = [crowd.answer(seconds + MARGIN_S) for crowd in crowds]
    times = [time for answer in answers for time in answer["times_ms"]]
    return {
        "per_s": sum(len(answer["times_ms"]) / answer["elapsed_s"] for answer in answers),
        "p50_ms": statistics.median(times),
        "p99_ms": percentile(times, 99),
    }
