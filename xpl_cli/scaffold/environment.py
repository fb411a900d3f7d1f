"""Rendering of environment packages from the template."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from xpl import robots
from xpl.robots import has_frames
from xpl_cli.basics.errors import UserError
from xpl_cli.packages.package import ENV
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold import template as templates
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.scaffold.lock import Lock
    from xpl_cli.scaffold.template import Files


@dataclass(frozen=True)
class EnvAnswers:
    """The author's answers; recorded in the package for later updates.

    Attributes:
        name: of the package and its folder.
        embodiment: its robot, by the standard's name.
        task: name of its first task.
    """

    name: str
    embodiment: str
    task: str


def env_defaults() -> dict[str, Any]:
    """Return the template's default answers."""
    return {key: entry["default"] for key, entry in templates.questions(ENV).items() if "default" in entry}


def simulated_robots() -> list[str]:
    """Return the robots that the template's toy simulation can move: those with known kinematics."""
    return [name for name, entry in robots.entries().items() if has_frames(entry)]


def check_names(answers: EnvAnswers) -> None:
    """Check the names of package, task and robot.

    Raises:
        UserError: with the first invalid answer, and the nearest valid ones.
    """
    adapter.check_name(answers.name)
    adapter.check_choice("--embodiment", answers.embodiment, list(robots.entries()))
    identifier = spec.schema("common")["$defs"]["identifier"]["pattern"]
    if re.fullmatch(identifier, answers.task) is None:
        raise UserError(f"--task must be letters, digits and underscores, got {answers.task!r}")


def check_env(answers: EnvAnswers) -> None:
    """Check all answers.

    Raises:
        UserError: with the first invalid answer, and the nearest valid ones.
    """
    check_names(answers)
    if answers.embodiment in robots.entries() and answers.embodiment not in simulated_robots():
        raise UserError(
            f"the template's toy simulation needs kinematics, which {answers.embodiment} does not have",
            hint=f"start with another one ({', '.join(simulated_robots())}) and change env.yml later",
        )
    adapter.check_choice("--embodiment", answers.embodiment, simulated_robots())


def render_env(answers: EnvAnswers) -> Files:
    """Render the environment template; deterministic in the answers.

    Returns:
        content by file name, relative to the package; sorted.
    """
    conventions = spec.data("conventions")
    arms = len(robots.entries()[answers.embodiment]["arms"])
    context = {
        **asdict(answers),
        "yaml_name": templates.as_yaml(answers.name),
        "spec_version": spec.VERSION,
        "placeholder": spec.data("package")["placeholder"],
        "action_types": list(conventions["action"]["types"]),
        "camera": conventions["cameras"]["by_arms"][arms][0],
        "class_name": class_name(answers.task),
    }
    return adapter.with_lock(templates.render(ENV, context), ENV, asdict(answers))


def recorded_env_answers(package_lock: Lock) -> EnvAnswers:
    """Return the recorded answers of a scaffolded environment; newer questions have their defaults.

    Raises:
        UserError: the recorded answers are invalid.
    """
    with adapter.answer_errors("an environment"):
        answers = EnvAnswers(**adapter.merged_answers(package_lock, EnvAnswers, env_defaults()))
        check_env(answers)
    return answers


def class_name(task: str) -> str:
    """Return the class name of a task."""
    return "".join(word.capitalize() for word in task.split("_")) or "Task"
