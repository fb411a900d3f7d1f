"""Runs an adapter in a process of its interpreter without server and client, to compare the served one with."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xpl
from xpl.process.child import SDK_START
from xpl.wire import packed
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.isolation import family, sandbox
from xpl_cli.lifecycle import interpreter

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.audit.rules.options import Options
    from xpl_cli.audit.served.probe import Probe

LIMIT_S = 600.0
"""Longest run: as long as a server may take to load the model."""

Call = tuple[str, tuple[Any, ...]]
"""A method and its arguments."""


def answers(probe: Probe, script: Sequence[Call], *, watch: bool = False) -> list[dict[str, Any]]:
    """Return what an adapter answers to a script of calls in one process; each is a map of a `result` or an `error`.

    Args:
        probe: the adapter.
        script: the calls.
        watch: note what the model does to its observations; the script may ask for the notes (`xpl.worker.watch`).

    Raises:
        NotRun: if the adapter cannot be loaded there, or the process ends or hangs.
    """
    package, options, choice = probe.package, probe.options, probe.choice
    python = interpreter.resolve(package.path, package.manifest, python=options.python, env=options.env or choice.env)
    order = {
        "policy_dir": str(package.path),
        "config": probe.config,
        "manifest": package.manifest,
        "script": [[method, list(arguments)] for method, arguments in script],
        "watch": watch,
        **choice.stand_in.message,
    }
    with _place(package.path, options) as (prefix, folder, environment):
        asked, told = folder / "script", folder / "answers"
        asked.write_bytes(b"".join(packed.encode(order)))
        start = SDK_START + "from xpl.worker.inprocess import main; main(*sys.argv[2:])"
        command = [*prefix, python, "-c", start, str(Path(xpl.__file__).parent), str(asked), str(told)]
        output = _run(command, package.path, environment, folder / "log")
        if not told.is_file():
            last = next((line.strip() for line in reversed(output.splitlines()) if line.strip()), "it printed nothing")
            raise NotRun(f"the adapter's process ended without an answer: {last:.200}")
        found = packed.decode(told.read_bytes())
    if "error" in found:
        raise NotRun(f"the model could not be loaded without the server: {found['error']}")
    answered = [packed.decode(answer) for answer in found["answers"]]
    unreal = next((answer["error"] for answer in answered if answer.get("unreal")), None)
    if unreal is not None:
        raise NotRun(unreal)
    return answered


@contextlib.contextmanager
def _place(checkout: Path, options: Options) -> Iterator[tuple[tuple[str, ...], Path, dict[str, str]]]:
    """Yield what is put before a command, a folder that it may write to, and its environment; as a server has them."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    environment.pop("PYTHONHOME", None)
    if options.isolate:
        with sandbox.isolated(checkout) as isolation:
            assert isolation.folder is not None  # noqa: S101 - for the type checker: isolated ones have one
            yield isolation.prefix, isolation.folder, isolation.environment(environment)
        return
    prefix = sandbox.kept_apart(checkout).prefix if options.apart else ()
    with tempfile.TemporaryDirectory(prefix="xpl-") as folder:
        yield prefix, Path(folder), environment


def _run(command: list[str], cwd: Path, environment: dict[str, str], log: Path) -> str:
    """Run a command in a group of its own, end all that it started, and return what it printed."""
    before = {member.pid for member in family.descendants(os.getpid())}
    family.adopt_orphans()
    # A file, not a pipe: a process that the adapter leaves behind would keep a pipe open.
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        )
    try:
        process.wait(LIMIT_S)
    except subprocess.TimeoutExpired:
        raise NotRun(f"the adapter's process did not end within {LIMIT_S:g} s") from None
    finally:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        family.end_adopted(before)
    return log.read_text(encoding="utf-8", errors="replace")
