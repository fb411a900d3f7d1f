"""Read manifests: the map in a YAML file, or one error that lists all problems."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.standard.problems import Problem

_MOST_SHOWN = 20


class ManifestError(UserError):
    """A manifest with problems.

    Args:
        path: the file.
        schema: name of its schema.
        problems: its problems, with their positions.
    """

    def __init__(self, path: Path, schema: str, problems: Sequence[Problem]) -> None:
        lines = [f"  {problem}" for problem in problems[:_MOST_SHOWN]]
        if len(problems) > _MOST_SHOWN:
            lines.append(f"  and {len(problems) - _MOST_SHOWN} more")
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        page = f"; {problems[0].page.partition('#')[0]} explains them" if problems[0].page else ""
        super().__init__(
            "\n".join([f"{path} has {count}", *lines]),
            hint=f"`xpl spec show {schema}` lists every key{page}",
            code=ExitCode.USAGE,
        )
        self.path, self.schema, self.problems = path, schema, tuple(problems)

    def details(self) -> dict[str, Any]:
        """Return the entries for `xpl.error/1`."""
        from xpl_cli.standard.problems import problem_json

        return {
            "kind": "manifest",
            "file": str(self.path),
            "problems": [problem_json(problem) for problem in self.problems],
            "next": [f"xpl spec show {self.schema}"],
        }


def read(path: Path, schema: str) -> dict[str, Any]:
    """Return the map in a manifest after validation; an empty map if there is no such file.

    Missing keys are accepted: a run has defaults for them, and the audit reports them.

    Args:
        path: the file.
        schema: name of its schema.

    Raises:
        ManifestError: if the document has problems.
        UserError: if the file cannot be read.
    """
    from xpl_cli.standard.validate import validate_yaml

    content = content_of(path)
    if content is None:
        return {}
    display_path = _display_path(path)
    data, problems = validate_yaml(content, str(display_path), schema)
    wrong = [problem for problem in problems if problem.missing is None]
    if wrong:
        raise ManifestError(display_path, schema, wrong)
    result: dict[str, Any] = data
    return result


def _display_path(path: Path) -> Path:
    """Return a path for messages: relative to the working directory if below it."""
    from pathlib import Path

    here = Path.cwd()
    return path.relative_to(here) if path.is_absolute() and path.is_relative_to(here) else path


def content_of(path: Path) -> bytes | None:
    """Return the content of a manifest's file up to the size limit; None if there is no such file.

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
