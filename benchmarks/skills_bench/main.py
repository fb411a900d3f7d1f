"""The command line of `benchmarks/skills.py`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.skills_bench import cases, report, runs
from benchmarks.skills_bench.agent import Agent
from benchmarks.skills_bench.project import CONDITIONS
from benchmarks.skills_bench.runs import Plan, Result
from xpl_cli.agents.skills.bundle import SkillBundle, bundles
from xpl_cli.basics import atomic

PARTS = ("triggers", "tasks")


def main(description: str | None, arguments: Sequence[str] | None = None) -> int:
    """Make the runs, print the table, write the document on request; return the exit code."""
    skills = bundles()
    options = _options(description, [skill.name for skill in skills], arguments)
    plans = _plans(options, skills)

    def keep(results: list[Result]) -> None:
        if options.json:
            text = json.dumps(report.document(results), indent=2) + "\n"
            atomic.write_file(options.json, text.encode())

    results = runs.all_of(plans, skills, options.timeout, keep)
    keep(results)
    print(report.table(report.document(results)))
    return 130 if any(result.reason == runs.INTERRUPTED for result in results) else 0


def _options(description: str | None, names: list[str], arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    help_text = "an agent, and how it is called without a terminal; may be repeated"
    parser.add_argument("--agent", action="append", default=[], type=_agent, metavar="NAME=COMMAND", help=help_text)
    help_text = "what agents have in tasks (default: all): " + ", ".join(CONDITIONS)
    parser.add_argument("--condition", action="append", choices=CONDITIONS, metavar="CONDITION", help=help_text)
    parser.add_argument("--part", action="append", choices=PARTS, help="only queries, or only tasks")
    parser.add_argument("--skill", action="append", choices=names, metavar="NAME", help="only these skills")
    parser.add_argument("--task", action="append", metavar="NAME", help="only these tasks")
    parser.add_argument("--repeat", type=int, default=1, metavar="N", help="how often each run is made")
    parser.add_argument("--timeout", type=float, default=1800.0, metavar="S", help="for each run (default: 1800)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all runs to a file")
    return parser.parse_args(arguments)


def _agent(text: str) -> Agent:
    try:
        return Agent.read(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _plans(options: argparse.Namespace, skills: Sequence[SkillBundle]) -> list[Plan]:
    """Return all possible runs; those that the options leave out have the reason."""
    agents: list[Agent | None] = options.agent or [None]
    plans = []
    for agent in agents:
        for skill in skills:
            left_out = _left_out("--skill", options.skill, skill.name)
            for repeat in range(1, options.repeat + 1):
                triggers = left_out or _left_out("--part", options.part, "triggers")
                plans += [Plan(query, agent, "skills", repeat, triggers) for query in cases.queries(skill.folder)]
                for task in cases.tasks(skill.folder):
                    tasks = left_out or _left_out("--part", options.part, "tasks")
                    tasks = tasks or _left_out("--task", options.task, task.name)
                    for condition in CONDITIONS:
                        unwanted = tasks or _left_out("--condition", options.condition, condition)
                        plans.append(Plan(task, agent, condition, repeat, unwanted))
    return plans


def _left_out(option: str, selected: list[Any] | None, name: str) -> str | None:
    return None if selected is None or name in selected else f"left out by {option}"
