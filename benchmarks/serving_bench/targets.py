"""What ours is to reach, judged by the figures of the same run, the same bytes against the same bytes."""

from __future__ import annotations

from typing import Any

from benchmarks.serving_bench.contenders import PEERS, TCP, WEBSOCKETS, XPL, XPL_SAME, XPL_WEBSOCKET

LARGE, SMALL = "3x480x640", "state"
TCP_RATIO = 1.5
WEBSOCKETS_RATIO = 2.0
PER_S = 265.0
LOSS = 0.03
"""Difference of two runs of the same thing on a quiet machine."""
RESPONSE_MS = 20.0


def judge(
    latency: list[dict[str, Any]], throughput: list[dict[str, Any]], responsiveness: list[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the targets: `target` (a sentence), `wanted` and `got` (numbers), `met`; None where not measured."""
    p50 = {(row["contender"], row["payload"]): row["p50_ms"] for row in latency}
    shared = {row["contender"]: row["shared_memory"] for row in latency}
    rate = {(row["contender"], row["setting"], row["clients"]): row.get("per_s") for row in throughput}
    response = {
        what: row[what]["p99_ms"]
        for row in responsiveness
        if row["contender"] == XPL and "failed" not in row
        for what in ("handshake", "heartbeat")
    }
    peers = [time for (name, payload), time in p50.items() if name.partition("/")[0] in PEERS and payload == LARGE]
    bare = [time for (name, payload), time in p50.items() if name.partition("/")[0] == WEBSOCKETS and payload == SMALL]
    return [
        _at_most(
            f"{LARGE} through shared memory: p50 at most {TCP_RATIO} times raw TCP, ms",
            _times(p50.get((TCP, LARGE)), TCP_RATIO),
            p50.get((XPL_SAME, LARGE)) if shared.get(XPL_SAME) else None,
        ),
        _at_most(
            f"{LARGE} over WebSocket: p50 below every peer that ran, ms",
            min(peers, default=None),
            None if shared.get(XPL_WEBSOCKET) else p50.get((XPL_WEBSOCKET, LARGE)),
        ),
        _at_most(
            f"state only: p50 at most {WEBSOCKETS_RATIO:g} times bare websockets, ms",
            _times(min(bare, default=None), WEBSOCKETS_RATIO),
            p50.get((XPL_SAME, SMALL)),
        ),
        _at_least("8 clients: inferences per second", PER_S, rate.get((XPL_SAME, "same+shared", 8))),
        _at_least(
            "1 client of a shared model: no loss to one that is not shared, inferences per second",
            _times(rate.get((XPL_SAME, "same", 1)), 1 - LOSS),
            rate.get((XPL_SAME, "same+shared", 1)),
        ),
        _at_most("handshake during an inference: p99, ms", RESPONSE_MS, response.get("handshake")),
        _at_most("heartbeat during an inference: p99, ms", RESPONSE_MS, response.get("heartbeat")),
    ]


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _at_most(target: str, limit: float | None, got: float | None) -> dict[str, Any]:
    met = None if limit is None or got is None else got <= limit
    return {"target": target, "wanted": limit, "got": got, "met": met}


def _at_least(target: str, limit: float | None, got: float | None) -> dict[str, Any]:
    met = None if limit is None or got is None else got >= limit
    return {"target": target, "wanted": limit, "got": got, "met": met}
