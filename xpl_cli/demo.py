"""The demo: scaffold, serve and audit an adapter, and catch a broken copy."""

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
class DemoStep:
    """One command of the demo.

    Attributes:
        title: what it demonstrates.
        command: the arguments after `xpl`.
        expected: the expected exit code.
        code: the actual exit code.
        seconds: how long it took.
    """

    title: str
    command: Sequence[str]
    expected: int = ExitCode.CLEAN
    code: int | None = None
    seconds: float = 0.0


@dataclass
class Demo:
    """The demo in a folder.

    Attributes:
        folder: of the adapters.
        report_progress: called when a step begins.
        quiet: whether to discard the commands' output, because the answer is JSON.
    """

    folder: Path
    report_progress: Callable[[str], None]
    quiet: bool = False
    steps: list[DemoStep] = field(default_factory=list)

    def run(self) -> bool:
        """Run the demo; return whether every step had the expected exit code."""
        self._run(DemoStep("Scaffold an adapter from the spec", ["new-policy", NAME]))
        self._serve(f"policy/{NAME}")
        self._run(DemoStep("Audit it: static, offline closed loop, MuJoCo", ["audit", f"policy/{NAME}"]))
        self.report_progress(f"\n# Break a copy: {BROKEN} reads the list of running environments by position")
        self._break(self.folder / "policy" / BROKEN)
        caught = DemoStep("Audit the broken copy", ["audit", f"policy/{BROKEN}"], ExitCode.FINDINGS)
        self._run(caught)
        return all(step.code == step.expected for step in self.steps)

    def _run(self, step: DemoStep) -> None:
        self.report_progress(f"\n# {step.title}\n$ xpl {' '.join(step.command)}")
        started = time.perf_counter()
        output = subprocess.DEVNULL if self.quiet else None
        completed = subprocess.run(
            [sys.executable, "-m", "xpl_cli", *step.command],
            cwd=self.folder,
            check=False,
            stdin=subprocess.DEVNULL,  # the demo never prompts
            stdout=output,
        )
        step.code, step.seconds = completed.returncode, round(time.perf_counter() - started, 2)
        self.steps.append(step)
        if step.code == ExitCode.INTERRUPTED:
            raise KeyboardInterrupt

    def _serve(self, policy: str) -> None:
        """Serve the adapter in its own process and request one action chunk."""
        from xpl import Client, get_embodiment
        from xpl import _spec as spec
        from xpl_cli.packages import environments, package
        from xpl_cli.serving.launch import running_server

        step = DemoStep("Serve it in its own process and request an action chunk", ["serve", policy])
        self.report_progress(f"\n# {step.title}\n$ xpl serve {policy}")
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
        self.report_progress(f"{server.url} returned {len(chunk)} action(s): {', '.join(chunk[0])}")

    def _break(self, target: Path) -> None:
        from xpl_cli.audit.engine.fixtures import build, fixtures
        from xpl_cli.audit.rules.registry import find

        slug, case = _BROKEN_BY
        build(next(subject for subject in fixtures(find(slug)) if subject.folder.name == case), target)


def run_demo(keep: Path | None, report_progress: Callable[[str], None], *, quiet: bool = False) -> Demo:
    """Run the demo in a temporary folder, or in `keep`, which must be new or empty.

    Raises:
        UserError: a step had an unexpected exit code, or `keep` is not empty.
    """
    if keep is not None and keep.is_dir() and any(keep.iterdir()):
        raise UserError(f"{keep} is not empty: the demo writes to a new folder only")
    with tempfile.TemporaryDirectory(prefix="xpl-demo-") as temporary:
        folder = keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        demo = Demo(folder, report_progress, quiet)
        if not demo.run():
            wrong = [step for step in demo.steps if step.code != step.expected]
            failures = "; ".join(
                f"`xpl {' '.join(step.command)}` ended with {step.code}, not {step.expected}" for step in wrong
            )
            raise UserError(f"the demo failed: {failures}", code=ExitCode.FINDINGS)
        return demo


def summary(demo: Demo) -> dict[str, Any]:
    """Return the answer of `xpl demo --json`."""
    steps = [
        {"title": step.title, "command": ["xpl", *step.command], "exit_code": step.code, "seconds": step.seconds}
        for step in demo.steps
    ]
    return {"steps": steps, "ok": True}
