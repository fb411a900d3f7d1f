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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest import mock

from tests.audit.offline.oracle.learned import Adapter, Mistake, adapters
from xpl import get_embodiment, trajectory
from xpl.action import ActionError
from xpl.client import PolicyServerError
from xpl.observation import ObservationError
from xpl.process.modules import load_module
from xpl.wire import packed
from xpl.worker import variants
from xpl_cli.audit.engine.checks import Checks
from xpl_cli.audit.offline.demonstrations.fact import Demonstrated
from xpl_cli.audit.offline.parity import blocks
from xpl_cli.audit.rules.facts import Facts
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import Options
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.rules.registry import find
from xpl_cli.packages.package import load

if TYPE_CHECKING:
    from xpl_cli.audit.rules.model import Result


class Local:
    """A model in this process that answers as a client of its server does, and what is asked of it."""

    def __init__(self, package: Path, demos: Path) -> None:
        self.package, self.options = load(package), Options(gates=(Gate.OFFLINE,), demos=demos)
        self.config = self.package.config({})
        self.embodiment = get_embodiment(self.config["env_cfg_type"])
        self.action_type = self.config["action_type"]
        self.profile = SimpleNamespace(name=Profile.FULL)
        self.required = tuple(self.package.manifest["inputs"]["required"])
        self.model = load_module(package / "model.py").Model({**self.config, "manifest": self.package.manifest})

    def server(self) -> Any:
        """Return what would be connected to."""
        return SimpleNamespace(url="")

    @contextmanager
    def session(self) -> Iterator[Any]:
        """Yield what answers."""
        yield self

    def connected(self, _url: str) -> Any:
        """Return what answers."""
        return self.session()

    def reset(self) -> Any:
        """Begin an episode."""
        return self.model.reset()

    def __getattr__(self, name: str) -> Any:
        method = getattr(self.model, name)

        def asked(*arguments: Any) -> Any:
            try:
                return method(*arguments)
            except (ActionError, ObservationError, ValueError) as error:
                return PolicyServerError("call_failed", f"{type(error).__name__}: {error}")

        return asked

    def infer(self, obs: Any) -> Any:
        """Show an observation and ask about it."""
        told = self.__getattr__("update_obs")(obs)
        return told if isinstance(told, PolicyServerError) else self.__getattr__("get_action")()

    def blocks(self, _probe: Any, course: Any, _config: Any, tried: Any, wanted: Any, seconds: float) -> Any:
        """Return the answers under each block, as the errand does; the model is as it was afterwards."""
        own, predict = self.model.interface, self.model.predict
        order = {"calls": course.told(course.calls(wanted)), "seconds": seconds}
        answers = [packed.decode(one).get("result") for one in variants.variants(self.model, tried, order)]
        self.model.interface, self.model.predict = own, predict
        return [None if one is None else dict(zip(sorted(wanted), one, strict=True)) for one in answers]


def judged(package: Path, demos: Path) -> Result:
    """Return what XPL270 says of a package, without the processes of an audit."""
    probe, rule = Local(package, demos), find("demonstrations-fit")
    checks = Checks(
        Facts({"path": package, "demonstrations": Demonstrated(probe), "options": probe.options}, {}), "v1.2"
    )  # type: ignore[arg-type]
    with mock.patch.object(blocks, "answers", probe.blocks):
        return checks._checked(rule)


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
        result = judged(adapter.write(Path(place), weights, mistake), demos)
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
