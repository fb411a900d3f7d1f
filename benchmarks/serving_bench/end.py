"""One end of a contender, as a process in that contender's environment.

    python -m benchmarks.serving_bench.end server MODULE SETTING FIXED_MS SAMPLE_MS
    python -m benchmarks.serving_bench.end client MODULE SETTING ADDRESS
    python -m benchmarks.serving_bench.end crowd MODULE SETTING ADDRESS

All print a JSON line when they are ready, a server with its address. A client then answers each JSON line on standard
input, a measurement, with a JSON line. A crowd reads its number of clients, answers once all of them are connected,
reads the duration of the measurement, and answers with the times. All end when standard input does.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import json
import os
import queue
import signal
import sys
import threading
import time
from typing import Any

from benchmarks.serving_bench import payloads
from benchmarks.serving_bench.model import Model


def serve(module: Any, setting: str, model: Model) -> None:
    """Serve until standard input ends."""
    main = threading.main_thread().ident
    assert main is not None

    def watch() -> None:
        while os.read(0, 4096):
            pass
        signal.pthread_kill(main, signal.SIGINT)

    # A job in the background of a shell script inherits that interrupts are ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=watch, daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        module.serve(model, setting, lambda address: _say({"address": address}))


async def measure(module: Any, setting: str, address: str) -> None:
    """Connect and make the requested measurements, until standard input ends."""
    connection = await module.connect(address, setting)
    asks: dict[str, Any] = {}
    _say({"connected": True})
    commands = _read_commands()
    while True:
        # In a thread: a client that lives in this loop has to answer pings meanwhile.
        order = await asyncio.to_thread(commands.get)
        name = order["payload"]
        if name not in asks:
            asks[name] = connection.asking(payloads.make(name))
        _say({"times_ms": await _times(asks[name], order["requests"], order["limit_s"], order["warm_up"])})


async def _times(ask: Any, requests: int, limit_s: float, warm_up: int) -> list[float]:
    """Return the duration of each request, ms; fewer than requested if the time is up."""
    for _ in range(warm_up):
        await ask()
    times: list[float] = []
    limit = time.perf_counter() + limit_s
    while len(times) < requests and (started := time.perf_counter()) < limit:
        await ask()
        times.append((time.perf_counter() - started) * 1000)
    return times


def crowd(module: Any, setting: str, address: str) -> None:
    """Connect several clients, a thread each, and let them all send requests; two commands come from stdin."""
    commands = _read_commands()
    order = commands.get()
    payload = payloads.make(order["payload"])
    connected: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    start = threading.Event()
    seconds = 0.0
    times: list[float] = []

    async def client() -> None:
        connection = await module.connect(address, setting)
        ask = connection.asking(payload)
        await ask()
        connected.put(None)
        start.wait()
        times.extend(await _times(ask, sys.maxsize, seconds, 0))
        await connection.close()

    def run() -> None:
        try:
            asyncio.run(client())
        except Exception as error:  # noqa: BLE001 - whatever a contender raises is its result
            connected.put(f"{type(error).__name__}: {error}")

    threads = [threading.Thread(target=run, daemon=True) for _ in range(order["clients"])]
    for thread in threads:
        thread.start()
    for _ in threads:
        if (failure := connected.get()) is not None:
            _say({"failed": failure})
            return
    _say({"connected": len(threads)})
    seconds = commands.get()["seconds"]
    started = time.perf_counter()
    start.set()
    for thread in threads:
        thread.join()
    elapsed_s = time.perf_counter() - started
    _say({"failed": connected.get()} if not connected.empty() else {"times_ms": times, "elapsed_s": elapsed_s})


def _read_commands() -> queue.SimpleQueue[dict[str, Any]]:
    """Return the queue of commands from standard input; once that ends, so does this process."""
    commands: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            commands.put(json.loads(line))
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    return commands


def _say(value: dict[str, Any]) -> None:
    _answers.write(json.dumps(value) + "\n")
    _answers.flush()


# A contender may print: its output must not be taken for answers.
_answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)

if __name__ == "__main__":
    side, name, chosen, *rest = sys.argv[1:]
    end = importlib.import_module(f"benchmarks.serving_bench.ends.{name}")
    if side == "server":
        serve(end, chosen, Model(*map(float, rest)))
    elif side == "client":
        asyncio.run(measure(end, chosen, *rest))
    else:
        _say({"started": True})
        crowd(end, chosen, *rest)
