"""Manifests as commands read them: the map in a YAML file, or one error that lists all that is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.standard.problems import Problem

_MOST_SHOWN = 20


class ManifestError(UserError):
    """A manifest that cannot be relied on.

    Args:
        path: the file.
        schema: name of its schema.
        problems: all that is wrong with it, with their places.
    """

    def __init__(self, path: Path, schema: str, problems: Sequence[Problem]) -> None:
        shown = [f"  {problem}" for problem in problems[:_MOST_SHOWN]]
        if len(problems) > _MOST_SHOWN:
            shown.append(f"  and {len(problems) - _MOST_SHOWN} more")
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        page = f"; {problems[0].page.partition('#')[0]} explains them" if problems[0].page else ""
        super().__init__(
            "\n".join([f"{path} has {count}", *shown]),
            hint=f"`xpl spec show {schema}` lists every key{page}",
            code=ExitCode.USAGE,
        )
        self.path, self.schema, self.problems = path, schema, tuple(problems)

    def details(self) -> dict[str, Any]:
        """Return the file, its problems, and the command that lists every key."""
        from xpl_cli.standard.problems import problem_json

        return {
            "kind": "manifest",
            "file": str(self.path),
            "problems": [problem_json(problem) for problem in self.problems],
            "next": [f"xpl spec show {self.schema}"],
        }


def read(path: Path, schema: str) -> dict[str, Any]:
    """Return the map in a manifest, in which everything that is there is right; an empty map if there is no such file.

    Keys may be missing: whoever runs a package has values for them, and the audit holds its author to all.

    Args:
        path: the file.
        schema: name of its schema.

    Raises:
        ManifestError: with every problem that the document has.
        UserError: if the file cannot be read.
    """
    from xpl_cli.standard.validate import validate_yaml

    content = content_of(path)
    if content is None:
        return {}
    shown = _shown(path)
    data, problems = validate_yaml(content, str(shown), schema)
    wrong = [problem for problem in problems if problem.missing is None]
    if wrong:
        raise ManifestError(shown, schema, wrong)
    result: dict[str, Any] = data
    return result


def _shown(path: Path) -> Path:
    """Return a path as the user would write it: from the working directory, where the file lies below it."""
    from pathlib import Path

    here = Path.cwd()
    return path.relative_to(here) if path.is_absolute() and path.is_relative_to(here) else path


def content_of(path: Path) -> bytes | None:
    """Return what a manifest's file holds, up to what any manifest holds; None if there is no such file.

    Raises:
        UserError: if it cannot be read.
    """
    from xpl_cli.basics.yaml.text import MOST_BYTES

    if not path.is_file():
        return None
    try:
        with path.open("rb") as stream:
            return stream.read(MOST_BYTES + 1)
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
