"""The evaluations of the skills: cases that can be trusted, and a runner that records what was done, and what not."""

from __future__ import annotations

import json
import re
import shlex
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.skills_bench import cases, effort, graders, runs, witness
from benchmarks.skills_bench.agent import Agent
from benchmarks.skills_bench.cases import Query, Task
from benchmarks.skills_bench.main import main
from benchmarks.skills_bench.project import CONDITIONS, project
from benchmarks.skills_bench.runs import Plan
from tests.support.quoted_commands import QuotedCommand, command_error
from xpl_cli.agents.skills.bundle import bundles, contents

SKILLS = bundles()
NAMES = {skill.name for skill in SKILLS}
TASKS = [task for skill in SKILLS for task in cases.tasks(skill.folder)]
LIMIT_S = 60.0

each_skill = pytest.mark.parametrize("skill", SKILLS, ids=lambda skill: skill.name)
each_task = pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)

STATIC = {"rule": {"target": "policy/Here", "code": "XPL139"}}
"""A check that takes a second: no placeholder is left."""


@pytest.fixture
def task(tmp_path: Path) -> Task:
    """Return a small task: a scaffold to begin with, and a file that is given."""
    given = tmp_path / "evals" / "files" / "small" / "upstream"
    given.mkdir(parents=True)
    (given / "code.py").write_text("one = 1\n\ntwo = 2\n", encoding="utf-8")
    setup = ("xpl new-policy Here --embodiment arx_x5_single --eval-only",)
    return Task(
        "xpl-integrate-policy", "small", "Do it.", tmp_path / "evals", setup, (STATIC, {"unchanged": "upstream/"})
    )


@pytest.fixture
def program(tmp_path: Path) -> Callable[[str], Agent]:
    """Return a function that makes an agent of a few lines of Python; its prompt is `sys.argv[1]`."""

    def make(lines: str) -> Agent:
        path = tmp_path / "agent.py"
        path.write_text("import json, pathlib, subprocess, sys, time\n" + lines, encoding="utf-8")
        return Agent.read(f"tried={shlex.join([sys.executable, str(path)])} {{prompt}}")

    return make


def _make(case: Query | Task, agent: Agent | None, condition: str = "skills", limit_s: float = LIMIT_S) -> runs.Result:
    return runs.make(Plan(case, agent, condition, 1), SKILLS, limit_s)


# -- the cases ---------------------------------------------------------------------------------------------------------


@each_task
def test_a_task_can_be_set_and_understood(task: Task) -> None:
    """Nothing of the evaluations gets into a project with the skills, either."""
    assert [
        wrong
        for line in task.setup
        if (wrong := command_error(QuotedCommand(tuple(shlex.split(line)[1:]), exact=True)))
    ] == []
    assert not any(cases.EVALS in Path(name).parts for name in contents(task.folder.parent))
    assert not any(name in task.prompt for name in NAMES)
    assert graders.REPORT in task.prompt
    for check in task.checks:
        for pattern in (check.get("answer"), check.get("answer_not")):
            assert pattern is None or re.compile(pattern)


@pytest.mark.slow
@pytest.mark.timeout(600)
@each_task
def test_a_task_is_not_done_before_anybody_did_it(task: Task) -> None:
    with project(task, "none") as place:
        assert not all(grade.passed for grade in graders.grades(task, place))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("small: {prompt: p, setup: []}", "must have prompt, setup and checks"),
        ("small: {prompt: p, setup: [], checks: [{magic: 1}]}", "each check is one of"),
        ("small: {prompt: p, setup: [], checks: [{answer: yes}]}", "not judged by an audit"),
        ("[]", "must be a mapping"),
    ],
)
def test_tasks_of_another_form_are_refused(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / cases.EVALS).mkdir()
    (tmp_path / cases.EVALS / "tasks.yml").write_text(text, encoding="utf-8")
    with pytest.raises(cases.CaseError, match=told):
        cases.tasks(tmp_path)


# -- what is not run ---------------------------------------------------------------------------------------------------


def test_what_is_left_out_is_recorded_as_not_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "found.json"
    assert main("", ["--json", str(path)]) == 0
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["schema"] == "xpl.skill-evals/1"
    queries = sum(len(cases.queries(skill.folder)) for skill in SKILLS)
    assert len(found["runs"]) == queries + len(TASKS) * len(CONDITIONS)
    assert {(run["status"], run["passed"]) for run in found["runs"]} == {("not run", None)}
    assert all("no agent was named" in run["reason"] for run in found["runs"])
    assert {row["rate"] for row in found["summary"]} == {None}
    assert "not run" in capsys.readouterr().out
    main("", ["--json", str(path), "--part", "tasks", "--skill", "xpl-debug-policy", "--condition", "docs"])
    reasons = {run["reason"] for run in json.loads(path.read_text(encoding="utf-8"))["runs"]}
    left_out = {f"left out by --{option}" for option in ("part", "skill", "condition")}
    assert reasons == {*left_out, "no agent was named (--agent)"}


@pytest.mark.parametrize(
    ("lines", "reason"),
    [(None, "no-such-agent"), ("sys.exit('please log in')", "please log in")],
    ids=["gone", "refuses"],
)
def test_an_agent_that_does_nothing_is_no_failure_of_the_skill(
    lines: str | None, reason: str, task: Task, program: Callable[[str], Agent]
) -> None:
    result = _make(task, Agent("nobody", ("no-such-agent", "{prompt}")) if lines is None else program(lines))
    assert (result.status, result.passed) == ("not run", None)
    assert reason in str(result.reason)


def test_after_an_interruption_the_rest_is_not_run(task: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = []

    def interrupted(*_: Any) -> None:
        begun.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "_task", interrupted)
    plans = [Plan(task, Agent("a", ("true",)), "none", repeat) for repeat in (1, 2)]
    results = runs.all_of(plans, SKILLS, LIMIT_S, lambda _: None)
    assert [result.reason for result in results] == ["interrupted", "interrupted"]
    assert len(begun) == 1


# -- what is run -------------------------------------------------------------------------------------------------------


def test_a_query_is_judged_by_the_skill_that_is_named(program: Callable[[str], Agent]) -> None:
    """The last name counts, as agents repeat the question; tokens are those that the agent reports."""
    right = "xpl-debug-policy"
    answer = {"result": right, "usage": {"input_tokens": 12, "output_tokens": 3, "tier": "standard"}}
    agent = program(f"print(sys.argv[1]); print(json.dumps({answer!r}))")
    result = _make(Query(right, "why?", right), agent)
    assert (result.status, result.passed, result.observed) == ("ran", True, right)
    assert result.tokens == {"input_tokens": 12, "output_tokens": 3}
    assert result.seconds is not None
    assert not _make(Query("xpl-audit-policy", "why?", None), agent).passed


@pytest.mark.slow
def test_a_task_is_judged_by_the_audit_and_not_by_what_is_said(task: Task, program: Callable[[str], Agent]) -> None:
    claim = "pathlib.Path('REPORT.md').write_text('Everything is green.')\n"
    changed_run = _make(task, program(claim + "pathlib.Path('upstream/code.py').write_text('')"))
    assert not changed_run.passed
    assert "changed: upstream/code.py" in [check["reason"] for check in changed_run.checks]
    deed = (
        "for path in pathlib.Path('policy/Here').rglob('*'):\n"
        "    if path.is_file() and '.xpl' not in path.parts:\n"
        "        path.write_text(path.read_text().replace('XPL-PLACEHOLDER', 'done'))\n"
        "subprocess.run(['xpl', 'audit', 'policy/Here', '--gate', 'static'], check=False)\n"
    )
    result = _make(task, program(claim + deed))
    assert (result.status, result.passed) == ("ran", True), result.checks
    assert result.commands == 1
    assert result.first_rollout_s is None  # the static gate plays nothing
    assert result.model_lines
    assert 0 < (result.written_lines or 0) < 20


@pytest.mark.slow
def test_an_agent_that_takes_too_long_is_ended_with_all_that_it_started(
    task: Task, program: Callable[[str], Agent]
) -> None:
    agent = program("subprocess.run(['sleep', '600'])")
    result = _make(task, agent, limit_s=1.0)
    assert (result.status, result.passed, result.in_time) == ("ran", False, False)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("condition", "has", "lacks"),
    [
        ("none", [], ["docs", ".agents", "AGENTS.md"]),
        ("docs", ["docs"], [".agents"]),
        ("skills", [".agents"], ["docs"]),
    ],
)
def test_conditions_differ_in_what_an_agent_finds(task: Task, condition: str, has: list[str], lacks: list[str]) -> None:
    with project(task, condition) as place:
        assert all((place.folder / name).exists() for name in has)
        assert not any((place.folder / name).exists() for name in lacks)
        assert not (place.folder / "docs" / "skills.md").exists()
        assert (place.environment[witness.HIDES] == "skills") == (condition != "skills")
        asked = Agent("a", ("xpl", "skills", "list")).ask("", place.folder, place.environment, LIMIT_S)
        assert (asked.code == 0) == (condition == "skills")


# -- the parts ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "played"),
    [
        ("  XPL-FINISH gate=mujoco pass pass=10 digest=68b6 fingerprint=3d9a", True),
        ('"finish": "XPL-FINISH gate=mujoco pass pass=10 digest=68b6"', True),
        ("  XPL-FINISH gate=mujoco pass pass=10 profile=shadow digest=68b6", False),
        ("  XPL-FINISH gate=mujoco fail fail=1", False),
        ("  XPL-FINISH gate=offline pass pass=41", False),
    ],
)
def test_a_rollout_is_known_by_the_finish_line(line: str, played: bool) -> None:
    assert bool(witness._PLAYED.search(line)) == played


@pytest.mark.slow
def test_lines_that_were_given_are_not_counted_as_written(task: Task) -> None:
    with project(task, "none") as place:
        assert effort.written_lines(task, place.folder) == 0
        package = place.folder / "policy" / "Here"
        (package / "code.py").write_bytes((place.folder / "upstream" / "code.py").read_bytes())
        assert effort.written_lines(task, place.folder) == 0
        (package / "code.py").write_text("one = 1\ntwo = 2\nthree = 3\n\nfour = 4\n", encoding="utf-8")
        assert effort.written_lines(task, place.folder) == 2
        assert (effort.model_lines(place.folder) or 0) > 5


def test_blank_lines_comments_and_docstrings_do_not_count() -> None:
    model = '''
        """Of the module,
        over lines."""
        # a comment

        import os  # counts

        class Model:
            """Of the class."""

            def reset(self):
                """Of the method,

                # with what looks like a comment
                """
                self.text = """counts

                counts"""
                return (
                    1,  # a statement over lines counts each of them
                )
    '''
    assert effort.code_lines(textwrap.dedent(model)) == 8
    assert effort.code_lines('def f(): "doc"\nclass A: "doc"; x = 1\n"not a docstring"\n') == 3
