"""Fit policies to demonstrations, plant conversion mistakes, and report what the oracle names right.

python -m tests.audit.offline.oracle.trial DEMOS [NAME...] [--json FILE] [--only MISTAKE]

DEMOS holds a folder of each task, as `xpl record mujoco --task TASK` makes them. A policy is fitted to 20 episodes, and
held against 8 of these, and against 8 others. The model answers in this process; XPL270's subjects are served.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.audit.offline.oracle.learned import Adapter, Mistake, adapters
from tests.audit.offline.oracle.local import Judged
from xpl import trajectory

FITTED = 20


def folder_of(episodes: list[trajectory.Trajectory], place: Path) -> Path:
    """Return a folder with links to some episodes."""
    place.mkdir()
    for episode in episodes:
        (place / Path(episode.path).name).symlink_to(os.path.realpath(episode.path))
    return place


def tried(adapter: Adapter, weights: dict[str, Any], demos: Path, mistake: Mistake | None) -> dict[str, Any]:
    """Return what became of an adapter with a mistake, or without one."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        result = Judged(adapter.write(Path(place), weights, mistake), demos).fit
    found = result.findings[0] if result.findings else None
    cause = dict(dict(found.evidence or {})["cause"]) if found is not None else {}
    told = found.message if found is not None else result.reason or json.dumps(result.proof)
    return {
        "adapter": adapter.name,
        "mistake": None if mistake is None else mistake.name,
        "outcome": str(result.outcome),
        "right": bool(cause) and mistake is not None and cause["convention"] in mistake.conventions,
        "words": cause.get("words"),
        "told": told,
        "seconds": round(time.monotonic() - started, 1),
    }


def main() -> None:
    """Try the policies that are named, or all, each right and with every mistake."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("demos", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", action="append", help="only mistakes of this name; `right` for none")
    parser.add_argument("--sample", choices=("in", "out"), action="append")
    asked = parser.parse_args()
    table, tally = [], collections.Counter[str]()
    with tempfile.TemporaryDirectory() as place:
        for adapter in adapters(asked.names):
            every = list(trajectory.open_folder(asked.demos / adapter.told["task"]))
            weights = adapter.fit(every[:FITTED])
            sets = {"in": every[:8], "out": every[-8:]}
            for sample in asked.sample or sets:
                demos = folder_of(sets[sample], Path(place) / f"{adapter.name}-{sample}")
                for mistake in (None, *adapter.mistakes):
                    name = "right" if mistake is None else mistake.name
                    if asked.only and name not in asked.only:
                        continue
                    row = {"sample": sample, **tried(adapter, weights, demos, mistake)}
                    table.append(row)
                    if mistake is None:
                        tally[f"{sample}: right adapters, {'accused' if row['words'] else 'not accused'}"] += 1
                    else:
                        tally[f"{sample}: planted, {'named right' if row['right'] else 'not named'}"] += 1
                    told = f"{adapter.name:10} {name:34} {row['right']!s:6} {row['told'][:400]}"
                    _say(f"{sample:4}{row['seconds']:6} {told}")
    for key, count in sorted(tally.items()):
        _say(f"{key} {count}")
    if asked.json:
        asked.json.write_text(json.dumps(table, indent=1))


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
