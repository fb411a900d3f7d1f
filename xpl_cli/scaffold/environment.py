"""Renders an environment package from the template of the standard."""

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
    """What an author chose; recorded in the package, so that the same render can be made again.

    Attributes:
        name: the package's name, which is its folder's.
        embodiment: robot that stands in it, by its name in the standard.
        task: name of its first task.
    """

    name: str
    embodiment: str
    task: str


def env_defaults() -> dict[str, Any]:
    """Return the template's default answers."""
    return {key: entry["default"] for key, entry in templates.questions(ENV).items() if "default" in entry}


def movable() -> list[str]:
    """Return the robots that the toy of the template can move: those whose kinematics the standard knows."""
    return [name for name, entry in robots.entries().items() if has_frames(entry)]


def check_names(answers: EnvAnswers) -> None:
    """Check the names of the package and its task, and that there is such a robot.

    Raises:
        UserError: with the first answer that is not allowed, and the nearest ones that are.
    """
    adapter.check_name(answers.name)
    adapter.check_choice("--embodiment", answers.embodiment, list(robots.entries()))
    identifier = spec.schema("common")["$defs"]["identifier"]["pattern"]
    if re.fullmatch(identifier, answers.task) is None:
        raise UserError(f"--task must be letters, digits and underscores, got {answers.task!r}")


def check_env(answers: EnvAnswers) -> None:
    """Check all answers.

    Raises:
        UserError: with the first answer that is not allowed, and the nearest ones that are.
    """
    check_names(answers)
    if answers.embodiment in robots.entries() and answers.embodiment not in movable():
        raise UserError(
            f"the template's toy needs known kinematics, and the standard has none of {answers.embodiment}",
            hint=f"start with another one ({', '.join(movable())}) and change env.yml when your simulator is in",
        )
    adapter.check_choice("--embodiment", answers.embodiment, movable())


def render_env(answers: EnvAnswers) -> Files:
    """Render the template of environments; the same answers always give the same bytes.

    Returns:
        file name, relative to the package, to content; sorted.
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
    return adapter.locked(templates.render(ENV, context), ENV, asdict(answers))


def recorded_env(kept: Lock) -> EnvAnswers:
    """Return the answers of an environment that was scaffolded; what its template did not ask then has the default.

    Raises:
        UserError: if they are not answers.
    """
    with adapter.reading_answers("an environment"):
        answers = EnvAnswers(**adapter.given(kept, EnvAnswers, env_defaults()))
        check_env(answers)
    return answers


def class_name(task: str) -> str:
    """Return the name of the class that plays a task."""
    return "".join(word.capitalize() for word in task.split("_")) or "Task"
