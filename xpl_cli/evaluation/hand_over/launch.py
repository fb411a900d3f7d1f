"""A hand-over from its request to its record: serve the policy, call the benchmark's launcher, read what it left."""

from __future__ import annotations

import contextlib
import datetime as dt
import glob
import json
import os
import re
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import xpl
from xpl import _spec as sdk
from xpl import get_embodiment, json_text
from xpl.manifest import PythonEnvironment
from xpl_cli.basics import atomic, files
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.environments.rollout import choose_name
from xpl_cli.evaluation.hand_over import process, record, results
from xpl_cli.evaluation.hand_over.answer import HandOverAnswer
from xpl_cli.evaluation.hand_over.launcher import RATE, Launcher, fill_placeholders
from xpl_cli.evaluation.hand_over.request import HandOverPlan, HandOverRequest
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.model import AttemptExecution, now
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Iterator


STATE_FILE = "hand_over.json"
_UNSAID = "default"
_UNSAID_ENVIRONMENTS = (None, "", "-", "null", "none")
"""Values of launchers for "no environment"."""
_SAFE = re.compile(r"[\w.:+-]+")
_MOST_BYTES = 1 << 20


def make_plan(request: HandOverRequest) -> HandOverPlan:
    """Return the plan of a request; nothing is started.

    Raises:
        UserError: the environment has no launcher, or not for this; there is no workspace; or `out` holds another run.
    """
    folder = environments.find(request.environment)
    facts = environments.manifest(folder)
    launcher = Launcher.read(facts)
    overrides = {sdk.Deploy.BENCH_NAME: launcher.bench_name, **request.overrides}
    config = request.package.config(overrides)
    task = request.task or config.get(sdk.Deploy.TASK_NAME) or next(iter(facts.tasks))
    config = {**config, sdk.Deploy.TASK_NAME: choose_name("task", task, list(facts.tasks))}
    robot = get_embodiment(str(config[sdk.Deploy.ENV_CFG_TYPE])).name
    choose_name("embodiment", robot, facts.embodiments)
    choose_name("action type", config[sdk.Deploy.ACTION_TYPE], facts.action_types)
    request.package.require_declared(config)
    checkpoint = str(config.get(sdk.Deploy.CKPT_NAME) or _UNSAID)
    values = {
        **{
            name: str(config.get(name))
            for name in (
                sdk.Deploy.BENCH_NAME,
                sdk.Deploy.TASK_NAME,
                sdk.Deploy.ENV_CFG_TYPE,
                sdk.Deploy.ACTION_TYPE,
                sdk.Deploy.SEED,
            )
        },
        sdk.Deploy.CKPT_NAME: checkpoint,
        "env_gpu_id": request.env_gpu,
        "eval_env": request.eval_env or "none",
        # As the ecosystem's eval.sh writes it.
        sdk.Obs.ADDITIONAL_INFO: f"ckpt_name={checkpoint},action_type={config[sdk.Deploy.ACTION_TYPE]}",
        sdk.Deploy.POLICY_NAME: request.package.name,
        "policy_dir": str(request.package.path),
        sdk.Deploy.EVAL_BATCH: str(bool(config.get(sdk.Deploy.EVAL_BATCH))).lower(),
        "episodes": str(request.episodes),
        "run_id": _run_id(request),
        "package": str(folder),
        "python": sys.executable,
        "workspace": str(folder.parent),
    }
    workspace = None if request.rehearse else launcher.workspace(request.workspace, values)
    if workspace is not None:
        values["workspace"] = str(workspace)
    return HandOverPlan(folder, facts, launcher, config, values, workspace)


def hand_over(request: HandOverRequest) -> HandOverAnswer:
    """Run the launcher and return the result.

    Raises:
        UserError: as for `make_plan`; the policy cannot be served, the launcher failed, or its result is unreliable.
    """
    planned = make_plan(request)
    if request.rehearse and request.out is not None:
        raise UserError("a rehearsal has no result to record: omit --out")
    if planned.launcher.entry.result.form == RATE and request.out is not None:
        raise UserError(
            f"{planned.launcher.bench_name} reports a rate without single episodes: it cannot be recorded",
            hint="omit --out",
        )
    before = set() if planned.workspace is None else _results(planned)
    if request.out is not None:
        request.out.mkdir(parents=True, exist_ok=True)
        state = json.dumps({"run_id": planned.values["run_id"], "values": dict(planned.values)}, indent=2) + "\n"
        atomic.write_file(request.out / STATE_FILE, state.encode())
    started, clock = now(), time.perf_counter()
    with _server_address(request, planned) as (host, port):
        words = planned.words(host, port)
        code = process.run(words, planned.workspace or Path.cwd(), _variables(request, planned), request.hours)
    seconds = time.perf_counter() - clock
    if code != 0:
        again = "; --resume may continue it" if request.out is not None else ""
        raise UserError(f"the launcher ended with exit code {code}{again}", code=ExitCode.NOT_RUN)
    answer = HandOverAnswer(
        environment=planned.facts.name,
        bench_name=planned.launcher.bench_name,
        policy=request.package.name,
        task=planned.config[sdk.Deploy.TASK_NAME],
        embodiment=get_embodiment(str(planned.config[sdk.Deploy.ENV_CFG_TYPE])).name,
        action_type=planned.config[sdk.Deploy.ACTION_TYPE],
        run_id=planned.values["run_id"],
        rehearsal=planned.workspace is None,
        command=words,
        seconds=round(seconds, 3),
    )
    if planned.workspace is None:
        return answer
    path = _find_result(planned, before)
    if planned.launcher.entry.result.form == RATE:
        return replace(answer, result=str(path), success_rate=results.rate(path))
    layouts = results.layouts(path)
    if request.out is not None:
        record.write(request, planned, path, layouts, AttemptExecution(started=started, wall_seconds=seconds))
    return answer.with_layouts(path, layouts)


def _run_id(request: HandOverRequest) -> str:
    """Return the name of a run: a time, as benchmarks sort them; the recorded one where a run goes on."""
    state_file = None if request.out is None else request.out / STATE_FILE
    if request.out is not None and (request.out / records.FILE).exists():
        raise UserError(f"{request.out} holds a recorded run already, and it is complete", hint="choose another --out")
    if request.resume:
        if state_file is None:
            raise NotFoundError("--resume goes on with the run in --out: name it")
        return _read_run_id(state_file)
    if state_file is not None and state_file.exists():
        raise UserError(f"{request.out} holds a run that was not completed", hint="--resume goes on with it")
    return dt.datetime.now().astimezone().strftime("%Y-%m-%d_%H-%M-%S")


def _read_run_id(file: Path) -> str:
    """Return the name of a run that was not completed."""
    try:
        run_id = json_text.parse(files.read_regular(file, _MOST_BYTES))["run_id"]
    except OSError:
        raise NotFoundError(f"{file.parent} holds no run that was handed over") from None
    except (json_text.JsonError, KeyError, TypeError):
        run_id = None
    if not isinstance(run_id, str) or not _SAFE.fullmatch(run_id) or ".." in run_id:
        raise UserError(f"{file} names no run", code=ExitCode.NOT_RUN)
    return run_id


def _variables(request: HandOverRequest, planned: HandOverPlan) -> dict[str, str]:
    """Return the environment variables of the launcher."""
    variables = dict(os.environ)
    if planned.workspace is None:
        ours = str(Path(xpl.__file__).parents[1])
        variables["PYTHONPATH"] = os.pathsep.join(filter(None, (ours, variables.get("PYTHONPATH"))))
    if request.eval_env not in _UNSAID_ENVIRONMENTS:
        from xpl_cli.lifecycle import interpreter

        folder = Path(interpreter.resolve(planned.folder, PythonEnvironment(), env=request.eval_env)).parent
        variables["PATH"] = os.pathsep.join(filter(None, (str(folder), variables.get("PATH"))))
    return {**variables, **planned.launcher.environment(planned.values)}


@contextlib.contextmanager
def _server_address(request: HandOverRequest, planned: HandOverPlan) -> Iterator[tuple[str, str]]:
    """Yield host and port of the policy server, which runs for the length of a `with` block."""
    if request.connect is not None:
        yield _host_and_port(request.connect)
        return
    from xpl_cli.serving.launch import running_server

    overrides = {**request.overrides, sdk.Deploy.BENCH_NAME: planned.launcher.bench_name}
    overrides[sdk.Deploy.TASK_NAME] = planned.config[sdk.Deploy.TASK_NAME]
    with running_server(
        request.package.path, overrides, python=request.python, env=request.env, gpu=request.gpu
    ) as server:
        yield _host_and_port(server.url)


def _host_and_port(url: str) -> tuple[str, str]:
    """Return host and port of an address.

    Raises:
        UserError: launchers cannot use it.
    """
    try:
        address = urlsplit(url)
        host, port = address.hostname, address.port
    except ValueError:
        host = port = None
    if not host or not port or address.scheme != "ws":
        raise UserError(f"launchers take ws://HOST:PORT, got {url!r}")
    return host, str(port)


def _results(planned: HandOverPlan) -> set[Path]:
    """Return the results that lie where the one of this run is to be."""
    assert planned.workspace is not None  # noqa: S101 - for the type checker: a rehearsal leaves none
    pattern = fill_placeholders(
        planned.launcher.entry.result.file, {name: glob.escape(value) for name, value in planned.values.items()}
    )
    paths = (path for path in planned.workspace.glob(pattern) if path.is_file())
    # A checkpoint's name may hold slashes, as the benchmarks' own paths do, and must not lead out of the workspace.
    return {path for path in paths if path.resolve().is_relative_to(planned.workspace)}


def _find_result(planned: HandOverPlan, before: set[Path]) -> Path:
    """Return the result that the launcher has written.

    Raises:
        UserError: there is none, or there are several.
    """
    results = _results(planned)
    new = results - before if "*" in planned.launcher.entry.result.file else results
    where = fill_placeholders(planned.launcher.entry.result.file, planned.values)
    if len(new) != 1:
        count = "no result" if not new else f"{len(new)} results"
        raise UserError(
            f"the launcher ended well and left {count} at {planned.workspace}/{where}", code=ExitCode.NOT_RUN
        )
    return new.pop()
