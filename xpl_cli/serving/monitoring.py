"""Monitoring: metrics for Prometheus and a trace of every request. Both are off by default."""

from __future__ import annotations

import json
import time
from typing import IO, TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl_cli.serving.server_log import log

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from xpl.wire import codec
    from xpl_cli.serving.workers.job_queue import RequestJob

Health = dict[str, Any]
"""Answer of `/healthz`: the state, slots, connections and workers (docs/serving.md)."""

_METHODS = frozenset((*spec.CONTRACT_METHODS, *spec.HOOKS, spec.Method.INFER))
_OTHER = "other"
"""Label for names that a client made up: each label stays in memory for as long as the server runs."""
_SECONDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 100.0)


class RequestMonitor:
    """Counts, times and traces requests.

    Args:
        metrics: count and time requests.
        trace: file that gets one JSON line per request, or None.

    Attributes:
        page: returns the metrics in Prometheus' text format; None if metrics are off.
    """

    def __init__(self, *, metrics: bool, trace: IO[str] | None) -> None:
        self._metrics = _PrometheusMetrics() if metrics else None
        self._trace = trace
        self.page: Callable[[], bytes] | None = None if self._metrics is None else self._metrics.page

    def export_health(self, health: Callable[[], Health]) -> None:
        """Export the server's state as metrics."""
        if self._metrics is not None:
            self._metrics.export_health(health)

    def record_answer(self, job: RequestJob, finished: float, size: int, outcome: str) -> None:
        """Record a request that a worker answered.

        Args:
            job: the request.
            finished: when the worker answered, s on the monotonic clock.
            size: bytes of the answer.
            outcome: `ok` or the error code.
        """
        sent = time.monotonic()
        if self._metrics is not None:
            self._metrics.record_answer(job, finished, size, outcome)
        if self._trace is not None:
            frame = job.frame
            started = job.started or finished
            line = {
                spec.Frame.MESSAGE_ID: frame.message_id,
                spec.Frame.MESSAGE_TYPE: frame.message_type,
                "method": job.method,
                spec.Frame.EVALUATION_ID: frame.evaluation_id,
                spec.Frame.TRIAL_ID: frame.trial_id,
                spec.Frame.STEP: frame.step,
                "worker": job.slot.worker,
                "client": job.slot.client,
                "outcome": outcome,
                "bytes_in": job.size,
                "bytes_out": size,
                "ms": {
                    "read": _ms(job.received, job.arrived),
                    "wait": _ms(job.arrived, started),
                    "model": _ms(started, finished),
                    "send": _ms(finished, sent),
                },
            }
            self._write(line)

    def record_refusal(self, frame: codec.Frame, code: str) -> None:
        """Record a request that the server refused without asking a worker."""
        if self._metrics is not None:
            self._metrics.record_refusal(frame.message_type, code)
        if self._trace is not None:
            line = {
                spec.Frame.MESSAGE_ID: frame.message_id,
                spec.Frame.MESSAGE_TYPE: frame.message_type,
                "outcome": code,
            }
            self._write(line)

    def _write(self, line: Mapping[str, object]) -> None:
        """Write a line of the trace; an error, such as a full disk, ends the trace only."""
        try:
            if self._trace is not None:
                self._trace.write(json.dumps(line) + "\n")
                self._trace.flush()
        except (OSError, ValueError) as error:
            log(f"the trace ends here: it cannot be written: {error}")
            self._trace = None


class _PrometheusMetrics:
    def __init__(self) -> None:
        from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

        self._registry = CollectorRegistry()
        registry = self._registry
        self._requests = Counter(
            "xpl_requests", "requests by method and outcome", ["method", "outcome"], registry=registry
        )
        self._wait = Histogram("xpl_wait_seconds", "time in the queue", ["method"], registry=registry, buckets=_SECONDS)
        self._model = Histogram(
            "xpl_model_seconds", "time at the worker", ["method"], registry=registry, buckets=_SECONDS
        )
        self._bytes = Counter("xpl_bytes", "bytes by direction", ["direction"], registry=registry)
        self._states = {
            name: Gauge(f"xpl_{name}", text, registry=registry)
            for name, text in {
                spec.ServerState.READY: "1 when the models are loaded",
                "connections": "open connections",
                "slots": "clients that can be served at once",
                "slots_in_use": "slots in use",
                "waiting": "requests in the queue",
                "busy_seconds": "how long the busiest worker has been busy",
                "memory_bytes": "memory of the workers",
            }.items()
        }

    def page(self) -> bytes:
        from prometheus_client import generate_latest

        return generate_latest(self._registry)

    def export_health(self, health: Callable[[], Health]) -> None:
        def over(key: str, of: Callable[[list[float]], float]) -> float:
            return of([float(worker[key]) for worker in health()["workers"]] or [0.0])

        sources: dict[str, Callable[[], float]] = {
            spec.ServerState.READY: lambda: float(health()[spec.Payload.STATE] == spec.ServerState.READY),
            "connections": lambda: float(health()["connections"]),
            "slots": lambda: float(health()["slots"]),
            "slots_in_use": lambda: float(health()["slots_in_use"]),
            "waiting": lambda: over("waiting", sum),
            "busy_seconds": lambda: over("busy_s", max),
            "memory_bytes": lambda: over("memory_bytes", sum),
        }
        for name, source in sources.items():
            self._states[name].set_function(source)

    def record_answer(self, job: RequestJob, finished: float, size: int, outcome: str) -> None:
        made_up = outcome == spec.ErrorCode.INVALID_FRAME and job.method not in _METHODS
        method = _OTHER if made_up else job.method
        self._requests.labels(method, outcome).inc()
        if job.started:
            self._wait.labels(method).observe(job.started - job.arrived)
            self._model.labels(method).observe(finished - job.started)
        self._bytes.labels("in").inc(job.size)
        self._bytes.labels("out").inc(size)

    def record_refusal(self, kind: str, code: str) -> None:
        self._requests.labels(kind if kind in spec.ANSWERS else _OTHER, code).inc()


def _ms(start: float, end: float) -> float:
    return round(1000.0 * (end - start), 3)
