"""The whole route in one command: scaffold, serve, audit, and a broken copy that is caught."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

NAME, BROKEN = "MyPolicy", "MyBrokenPolicy"
_BROKEN_BY = ("batch-order", "by-position")


@dataclass
class Step:
    """One command of the route.

    Attributes:
        title: what it shows.
        command: the arguments after `xpl`.
        expected: the exit code that shows it.
        code: the exit code it had.
        seconds: how long it took.
    """

    title: str
    command: Sequence[str]
    expected: int = ExitCode.CLEAN
    code: int | None = None
    seconds: float = 0.0


@dataclass
class Demo:
    """The route, played in a folder.

    Attributes:
        folder: where the adapters are made.
        say: told what begins.
        quiet: whether the commands' own output is swallowed, because the answer is JSON.
    """

    folder: Path
    say: Callable[[str], None]
    quiet: bool = False
    steps: list[Step] = field(default_factory=list)

    def play(self) -> bool:
        """Run the route; return whether every step ended as it should."""
        self._run(Step("Scaffold an adapter from the spec", ["new-policy", NAME]))
        self._serve(f"policy/{NAME}")
        self._run(Step("Audit it: static, offline closed loop, MuJoCo", ["audit", f"policy/{NAME}"]))
        self.say(f"\n# Break a copy: {BROKEN} reads the list of running environments by position")
        self._break(self.folder / "policy" / BROKEN)
        caught = Step("Audit the broken copy", ["audit", f"policy/{BROKEN}"], ExitCode.FINDINGS)
        self._run(caught)
        return all(step.code == step.expected for step in self.steps)

    def _run(self, step: Step) -> None:
        self.say(f"\n# {step.title}\n$ xpl {' '.join(step.command)}")
        started = time.perf_counter()
        output = subprocess.DEVNULL if self.quiet else None
        done = subprocess.run(
            [sys.executable, "-m", "xpl_cli", *step.command],
            cwd=self.folder,
            check=False,
            stdin=subprocess.DEVNULL,  # a demo asks nothing, on a terminal neither
            stdout=output,
        )
        step.code, step.seconds = done.returncode, round(time.perf_counter() - started, 2)
        self.steps.append(step)
        if step.code == ExitCode.INTERRUPTED:
            raise KeyboardInterrupt

    def _serve(self, policy: str) -> None:
        """Serve the adapter in its own process and ask it for one chunk."""
        from xpl import Client, get_embodiment
        from xpl import _spec as spec
        from xpl_cli.packages import environments, package
        from xpl_cli.serving.launch import running_server

        step = Step("Serve it in its own process and ask for an action chunk", ["serve", policy])
        self.say(f"\n# {step.title}\n$ xpl serve {policy}")
        started = time.perf_counter()
        path = self.folder / policy
        robot = get_embodiment(str(package.load(path).config()[spec.Deploy.ENV_CFG_TYPE]))
        obs = environments.module("offline", "scenario").observation(robot)
        with running_server(path) as server, Client(server.url) as client:
            client.reset()
            client.update_obs(obs)
            chunk = client.get_action()
        step.code, step.seconds = ExitCode.CLEAN, round(time.perf_counter() - started, 2)
        self.steps.append(step)
        self.say(f"{server.url} answered {len(chunk)} action step(s): {', '.join(chunk[0])}")

    def _break(self, target: Path) -> None:
        from xpl_cli.audit.engine.subjects import build, subjects
        from xpl_cli.audit.rules.registry import find

        slug, case = _BROKEN_BY
        build(next(subject for subject in subjects(find(slug)) if subject.folder.name == case), target)


def play(keep: Path | None, say: Callable[[str], None], *, quiet: bool = False) -> Demo:
    """Play the route in a temporary folder, or in `keep`, which must be new or empty.

    Raises:
        UserError: if a step did not end as it should, or `keep` holds something.
    """
    if keep is not None and keep.is_dir() and any(keep.iterdir()):
        raise UserError(f"{keep} is not empty: the demo writes into a new folder only")
    with tempfile.TemporaryDirectory(prefix="xpl-demo-") as temporary:
        folder = keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        demo = Demo(folder, say, quiet)
        if not demo.play():
            wrong = [step for step in demo.steps if step.code != step.expected]
            told = "; ".join(
                f"`xpl {' '.join(step.command)}` ended with {step.code}, not {step.expected}" for step in wrong
            )
            raise UserError(f"the demo did not go as it should: {told}", code=ExitCode.FINDINGS)
        return demo


def summary(demo: Demo) -> dict[str, Any]:
    """Return what `xpl demo --json` answers."""
    steps = [
        {"title": step.title, "command": ["xpl", *step.command], "exit_code": step.code, "seconds": step.seconds}
        for step in demo.steps
    ]
    return {"steps": steps, "ok": True}
