"""Episodes per hour of a recorded run, by its number of workers, and the cost of recording.

    ./dev bench evaluation      targets: 1.6 times the episodes with 2 workers on 2 cores; recording costs below 3 %

Episodes are those of the scripted expert without images: short ones, so that the work per episode has its largest
weight. Servers and environments are started beforehand; then the alternatives run the same episodes in turn, and the
median of the rounds' ratios counts. Recording is a line with fsync, and curves, against nothing; videos are left out,
because users choose their number. Processor time is that of all processes of the run. Wall times mean nothing on a busy
machine: the load at the beginning is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple, Self

from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.rollout.backend import BackendConfig, RolloutJob
from xpl_cli.evaluation.rollout.backends import make_backend
from xpl_cli.evaluation.rollout.config import Runtime
from xpl_cli.evaluation.runs import evaluate, plan, runner
from xpl_cli.evaluation.runs.plan import PlanRequest
from xpl_cli.evaluation.runs.schedule import Schedule
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import environments, package

ROOT = Path(__file__).resolve().parent.parent
POLICY, ENVIRONMENT, TASK = "scripted_expert", "mujoco", "lift_cube"
LEAST_SPEEDUP = 1.6
MOST_OVERHEAD = 0.03
BUSY = 0.5
_TICKS = os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=24, help="of each round (default: 24)")
    parser.add_argument("--rounds", type=int, default=7, help="of each comparison (default: 7)")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    options = parser.parse_args()
    load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    print(f"{cores} cores, load {load:.1f} at the beginning{'' if load < BUSY else ': too busy for wall times'}\n")
    with tempfile.TemporaryDirectory(dir=ROOT) as folder, _Suite(options.episodes, Path(folder)) as suite:
        figures = {
            "cores": cores,
            "load": load,
            "workers": workers(suite, options.rounds),
            "recording": recording(suite, options.rounds),
        }
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


class _Suite:
    """A plan, and backends with one worker and with two that are ready to run it.

    Args:
        episodes: of the plan.
        folder: of the records.
    """

    def __init__(self, episodes: int, folder: Path) -> None:
        adapter, environment = package.load(POLICY), environments.find(ENVIRONMENT)
        wishes = PlanRequest(tasks=TASK, episodes=episodes, horizon=1)
        self.plan = plan.make_plan(adapter, environment, adapter.config({}), wishes).plan
        self.episodes = episodes
        self._folder = folder
        self._runs = 0
        configs = evaluate.make_configs(adapter, environment, self.plan, Runtime(), IsolationSettings())
        self._backends = {count: make_backend(BackendConfig(workers=count), *configs, episodes) for count in (1, 2)}

    def __enter__(self) -> Self:
        for count in self._backends:
            self.play(count)
        return self

    def __exit__(self, *_: object) -> None:
        for backend in self._backends.values():
            backend.close()

    def play(self, workers: int = 1) -> _Timing:
        """Run without a record."""
        slots = self.plan.slots()
        jobs = [RolloutJob(slot.index, 1, slot.task, slot.setting, slot.seed, trace=False) for slot in slots]
        began = _now()
        lines = list(runner.rerun_episodes(self.plan, jobs, self._backends[workers]))
        took = _since(began)
        assert all(line.success for line in lines)
        return took

    def record(self, workers: int = 1) -> _Timing:
        """Run with a record."""
        self._runs += 1
        began = _now()
        with records.RecordWriter(self._folder / str(self._runs), self.plan) as writer:
            runner.run_schedule(writer, self._backends[workers], Schedule(writer.run, 0, lambda _: False), _Silent())
        took = _since(began)
        assert all(line.success for line in writer.run.finals.values())
        return took


def workers(suite: _Suite, rounds: int) -> dict[str, Any]:
    """Measure and print episodes per hour with one worker and with two."""
    took = [(suite.record(1), suite.record(2)) for _ in range(rounds)]
    rates = {count: [3600 * suite.episodes / pair[count - 1].wall for pair in took] for count in (1, 2)}
    speedup = statistics.median(one.wall / two.wall for one, two in took)
    for count, rates_per_hour in rates.items():
        print(f"{count} worker{'s' if count > 1 else ' '}  {statistics.median(rates_per_hour):>7.0f} episodes/h")
    print(f"speed-up   {speedup:>7.2f}   target {LEAST_SPEEDUP}: {'met' if speedup >= LEAST_SPEEDUP else 'missed'}\n")
    return {"episodes_per_hour": rates, "speedup": speedup}


def recording(suite: _Suite, rounds: int) -> dict[str, Any]:
    """Measure and print what a line, fsync and curves cost."""
    took = [(suite.play(), suite.record()) for _ in range(rounds)]
    figures: dict[str, Any] = {"episodes": suite.episodes}
    for kind in ("wall", "processor"):
        pairs = [(getattr(plain, kind), getattr(recorded, kind)) for plain, recorded in took]
        overhead = statistics.median(recorded / plain for plain, recorded in pairs) - 1
        figures[kind] = {"pairs": pairs, "overhead": overhead}
        plain, recorded = (1e3 * statistics.median(times) / suite.episodes for times in zip(*pairs, strict=True))
        met = "met" if overhead < MOST_OVERHEAD else "missed"
        print(f"{kind} time: {plain:.1f} ms an episode, recorded {recorded:.1f} ms: {overhead:+.1%}", end="   ")
        print(f"target below {MOST_OVERHEAD:.0%}: {met}")
    return figures


class _Silent:
    """A progress view without output."""

    def add(self, line: dict[str, Any], left: int) -> None:
        """Show nothing."""


class _Timing(NamedTuple):
    """Time of this process and its descendants, s."""

    wall: float
    processor: float


def _now() -> _Timing:
    return _Timing(time.perf_counter(), _processor_s(os.getpid()))


def _since(began: _Timing) -> _Timing:
    now = _now()
    return _Timing(now.wall - began.wall, now.processor - began.processor)


def _processor_s(root: int) -> float:
    """Return the processor time that a process and its living descendants have used so far, s."""
    parents, used = {}, {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(entry.name)], used[int(entry.name)] = int(fields[1]), int(fields[11]) + int(fields[12])

    def is_ours(pid: int) -> bool:
        while pid and pid != root:
            pid = parents.get(pid, 0)
        return pid == root

    return sum(ticks for pid, ticks in used.items() if is_ours(pid)) / _TICKS


if __name__ == "__main__":
    main()
