"""Audits of adapters that hang, kill, fork and delete: each comes to a verdict in time, and nothing is left."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import NotRun, Outcome, exit_code
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.time_limit import TimeLimit
from xpl_cli.audit.served import hanging
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.isolation import processes, sandbox
from xpl_cli.isolation.hang_detector import LONGER, HangDetector

Write = Callable[..., Path]

_PATIENCE = 2.0
MODEL = """
    import atexit, os, shutil, signal, subprocess, sys, threading, time
    import numpy as np

    {at_import}

    class Model:
        def __init__(self, config):
            {at_load}

        def update_obs(self, obs):
            pass

        def update_obs_batch(self, obs_list):
            self.envs = [obs["env_idx"] for obs in obs_list]

        def get_action(self):
            {at_answer}
            return [{{"arm_joint_state": np.zeros(7, np.float32), "ee_joint_state": np.zeros(1, np.float32)}}]

        def get_action_batch(self, env_idx_list=None):
            return [self.get_action() for _ in (self.envs if env_idx_list is None else env_idx_list)]

        def reset(self):
            {at_reset}
"""


@pytest.fixture
def audit(write_adapter: Write) -> Callable[..., Any]:
    """Return a function that audits an adapter that does something at some point; no process of ours is left then."""

    def run(*names: str, keep_going: bool = False, **deeds: str) -> Any:
        nothing = dict.fromkeys(("at_import", "at_load", "at_answer", "at_reset"), "pass")
        folder = write_adapter(textwrap.dedent(MODEL).format(**nothing | deeds))
        before = {member.pid for member in processes.descendants(os.getpid())}
        options = AuditOptions(gates=(Gate.OFFLINE,), names=names, patience=_PATIENCE, keep_going=keep_going)
        report = engine.audit(folder, "policy", options)
        left = [one.command for one in processes.descendants(os.getpid()) if one.pid not in before]
        assert not [command for command in left if str(folder) in command or "launch.py" in command]
        return report

    return run


def _texts(report: Any) -> str:
    found = [finding.message for result in report.results for finding in result.findings]
    return "\n".join([*found, *(str(result.reason) for result in report.results if result.reason)])


@pytest.mark.parametrize(
    ("deeds", "told", "place"),
    [
        ({"at_import": "time.sleep(600)"}, "gave no sign of life for 2 s", "model.py:5 in <module>"),
        pytest.param(
            {"at_load": "time.sleep(600)"}, "gave no sign of life for 2 s", "in __init__", marks=pytest.mark.slow
        ),
        pytest.param({"at_import": "while True: pass"}, "made no headway for 8 s", "<module>", marks=pytest.mark.slow),
        pytest.param(
            {"at_import": "os.kill(os.getpid(), signal.SIGSTOP)"}, "stopped by a signal", "", marks=pytest.mark.slow
        ),
        pytest.param(
            {"at_load": "threading.Thread(target=time.sleep, args=(600,)).start(); threading.Event().wait()"},
            "gave no sign of life",
            "in __init__",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_model_that_hangs_before_it_is_ready_is_a_finding_with_its_place(
    audit: Callable[..., Any], deeds: dict[str, str], told: str, place: str
) -> None:
    """It has the time that it was given, and the next rules do not wait again."""
    report = audit("serves", "worker-crash", "repeated-inference", **deeds)
    (finding,) = [finding for result in report.results for finding in result.findings]
    assert told in finding.message
    assert place in finding.message
    assert exit_code([report]) == ExitCode.FINDINGS
    assert {result.outcome for result in report.results} == {Outcome.FAIL, Outcome.NOT_RUN}


@pytest.mark.slow
@pytest.mark.parametrize("deed", ["time.sleep(600)", "while True: pass", "os.kill(os.getpid(), signal.SIGSTOP)"])
@pytest.mark.parametrize("when", ["at_answer", "at_reset"])
def test_a_model_that_hangs_over_a_question_is_a_finding(audit: Callable[..., Any], when: str, deed: str) -> None:
    """It is asked twice at most, whatever the number of rules."""
    report = audit(**{when: deed})
    assert exit_code([report]) == ExitCode.FINDINGS
    assert any(words in _texts(report) for words in ("gave no sign of life", "made no headway"))
    assert Outcome.ERROR not in {result.outcome for result in report.results}


@pytest.mark.parametrize(
    "deed",
    [
        "os.kill(-1, signal.SIGKILL)",
        pytest.param(
            "[os.kill(int(name), signal.SIGKILL) for name in os.listdir('/proc') if name.isdecimal() and name != '1' "
            "and int(name) != os.getpid()]",
            marks=pytest.mark.slow,
        ),
        pytest.param("os.killpg(os.getpgid(os.getppid()), signal.SIGTERM)", marks=pytest.mark.slow),
        pytest.param("os.kill(os.getppid(), signal.SIGKILL); os.kill(1, signal.SIGINT)", marks=pytest.mark.slow),
        pytest.param("os.kill(0, signal.SIGINT)", marks=pytest.mark.slow),
    ],
)
def test_a_model_that_kills_whatever_it_may_does_not_end_the_audit(audit: Callable[..., Any], deed: str) -> None:
    """It sees and signals its own processes and no others, a bystander of the same user among them."""
    try:
        sandbox.pid_isolation(Path.cwd())
    except UserError as error:
        pytest.skip(str(error))
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as bystander:
        report = audit("serves", "repeated-inference", "worker-crash", at_load=deed)
        assert bystander.poll() is None
        bystander.kill()
    assert exit_code([report]) in {ExitCode.CLEAN, ExitCode.FINDINGS, ExitCode.NOT_RUN}
    assert Outcome.ERROR not in {result.outcome for result in report.results}


@pytest.mark.slow
@pytest.mark.parametrize(
    "deed",
    [
        "threading.Thread(target=time.sleep, args=(900,)).start()",
        "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(900)'], start_new_session=True)",
        "atexit.register(time.sleep, 900)",
        "signal.signal(signal.SIGTERM, signal.SIG_IGN); os.fork() or time.sleep(900)",
    ],
)
def test_what_an_adapter_leaves_behind_holds_up_no_audit(audit: Callable[..., Any], deed: str) -> None:
    """Threads, children in sessions of their own, and what is registered for the end."""
    report = audit("serves", "remote-equals-local", "observation-intact", "leftover-processes", at_load=deed)
    assert Outcome.ERROR not in {result.outcome for result in report.results}
    assert not any("hung" in str(result.reason) for result in report.results)


@pytest.mark.slow
@pytest.mark.parametrize("when", ["at_load", pytest.param("at_answer", marks=pytest.mark.slow)])
def test_a_model_that_removes_its_own_folder_is_told_of(audit: Callable[..., Any], when: str) -> None:
    """What cannot be looked at any more is not run, with the reason; no rule crashes."""
    report = audit(keep_going=True, **{when: "shutil.rmtree(os.path.dirname(os.path.abspath(__file__)))"})
    assert Outcome.ERROR not in {result.outcome for result in report.results}
    assert exit_code([report]) in {ExitCode.FINDINGS, ExitCode.NOT_RUN}
    assert "removed" in _texts(report)


def test_time_that_is_over_ends_an_audit(audit: Callable[..., Any], write_adapter: Write) -> None:
    """Every rule that has not been tried is not run, and says why."""
    del audit
    folder = write_adapter(textwrap.dedent(MODEL).format(at_import="", at_load="pass", at_answer="", at_reset="pass"))
    options = AuditOptions(gates=(Gate.OFFLINE,), time_limit=TimeLimit("1s", 1e-6))
    report = engine.audit(folder, "policy", options)
    assert {result.outcome for result in report.results} == {Outcome.NOT_RUN}
    assert "1s for each package (--time-limit)" in _texts(report)
    assert exit_code([report]) == ExitCode.NOT_RUN


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90.0), ("60m", 3600.0), ("1.5 h", 5400.0), ("20", 20.0)])
def test_a_time_limit_is_read(text: str, seconds: float) -> None:
    assert TimeLimit.parse(text).seconds == seconds


@pytest.mark.parametrize("text", ["", "soon", "0", "-1h", "5 days", "1e9"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(UserError, match=r"90s.*60m.*none"):
        TimeLimit.parse(text)


def test_deadlines_of_a_stranger_have_an_end() -> None:
    """None, zero and a thousand years are no deadlines; what is reasonable stays."""
    asked = {"request_timeout_s": None, "max_connect_seconds": 0, "close_timeout_s": 1e12, "handshake_timeout_s": 5}
    assert hanging.bounded_timeouts(asked) == {
        "request_timeout_s": 300.0,
        "max_connect_seconds": 600.0,
        "close_timeout_s": 30.0,
    }


@pytest.mark.parametrize("value", [".inf", ".nan", "1.0e+308", "-1", "hello"])
def test_a_deadline_that_is_none_is_a_check_that_could_not_run(write_adapter: Write, value: str) -> None:
    """No crash of a rule: the file is the package's, and the static gate has the finding."""
    folder = write_adapter("class Model: pass")
    deploy = (folder / "deploy.yml").read_text().rstrip().removesuffix("}")
    (folder / "deploy.yml").write_text(f"{deploy}, request_timeout_s: {value}}}\n")
    report = engine.audit(folder, "policy", AuditOptions(gates=(Gate.OFFLINE,), names=("serves",)))
    (result,) = (result for result in report.results if result.slug == "serves")
    assert result.outcome is Outcome.NOT_RUN
    assert "request_timeout_s: expected" in str(result.reason)


def test_an_adapter_is_not_waited_for_again_and_again() -> None:
    """After it has hung twice, rules are told so at once."""
    hangs = hanging.HangCounter()
    for reason in (None, "it raised", "it gave no sign of life for 30 s"):
        hangs.note(reason)
        hangs.check()
    hangs.note("the model did not answer within 120 s")
    with pytest.raises(NotRun, match="hung 2 times"):
        hangs.check()


@contextlib.contextmanager
def _running(code: str) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stdin=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process
        process.kill()


def _verdict(life: HangDetector, until: float, step: float) -> str | None:
    """Look again and again, as if so much time went by between two looks."""
    now = time.monotonic()
    end = now + until
    while now < end:
        now += step
        reason = life.check(now)
        if reason is not None:
            return reason
    return None


def test_a_process_that_waits_gives_no_sign_of_life() -> None:
    """And one that is stopped is told apart."""
    with _running("print(flush=True); input()") as process:
        assert "no processor time" in str(_verdict(HangDetector(process.pid, 10.0, time.monotonic()), 60.0, 1.0))
        os.kill(process.pid, signal.SIGSTOP)
        os.waitpid(process.pid, os.WUNTRACED)
        assert "stopped by a signal" in str(_verdict(HangDetector(process.pid, 10.0, time.monotonic()), 60.0, 1.0))


def test_a_process_that_asks_for_memory_makes_headway() -> None:
    with _running("print(flush=True)\nkept = []\nwhile input() is not None: kept.append(b'x' * 9_000_000)") as process:
        assert process.stdin is not None
        now = time.monotonic()
        life = HangDetector(process.pid, 10.0, now)
        for look in range(1, 4 * LONGER):
            seen = processes.resident_bytes(process.pid)
            process.stdin.write(b"\n")
            process.stdin.flush()
            while processes.resident_bytes(process.pid) < seen + 8_000_000:
                pass
            assert life.check(now + 6.0 * look) is None
