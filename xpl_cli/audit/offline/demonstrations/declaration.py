"""The demonstrations that a policy is compared with: those of `--demos`, or those that `demonstrations.yml` names.

The file is spec/demonstrations/demonstrations.schema.json: a path and the digest of each episode.
"""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl import json_text
from xpl_cli.basics import content, files
from xpl_cli.basics.atomic import write_file
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.yaml import text as yaml_text

if TYPE_CHECKING:
    from collections.abc import Mapping

FILE: Final = "demonstrations.yml"
"""Stands beside policy.yml, whose frozen schema cannot take further keys."""
_MOST_BYTES: Final = 1 << 22


class DeclarationError(ValueError):
    """The file cannot be read, or does not fit its schema."""


def exists(package: Path) -> bool:
    """Tell whether a package names demonstrations; the static gate reports a folder that cannot be entered."""
    try:
        return (package / FILE).is_file()
    except OSError:
        return False


def read(package: Path) -> tuple[Path, Mapping[str, str]]:
    """Return the path that a package's file names, and the SHA-256 of each episode by its file's name below it.

    Raises:
        DeclarationError: it cannot be read, or does not fit its schema.
    """
    path = package / FILE
    try:
        document = yaml_text.parse(files.read_regular(path, _MOST_BYTES))
    except OSError as error:
        raise DeclarationError(f"{FILE} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise DeclarationError(f"{FILE} is no YAML: {error}") from None
    for problem in _validator().iter_errors(document):
        where = "/".join(map(str, problem.instance_path))
        raise DeclarationError(f"{FILE}{', ' + where if where else ''}: {problem.message}")
    entry = document["demonstrations"]
    return (package / str(entry["path"])).resolve(), dict(entry["digests"])


def render(path: str, digests: Mapping[str, str]) -> str:
    """Return the file's text for demonstrations at a path, as the package's folder sees it."""
    lines = [f"  {json.dumps(name)}: {json.dumps(digest)}" for name, digest in sorted(digests.items())]
    return "\n".join(
        [
            "# Demonstrations that an audit compares this policy with; `xpl data declare` writes it.",
            "demonstrations:",
            f"  path: {json.dumps(path)}",
            "  digests:",
            *(f"  {line}" for line in lines),
            "",
        ]
    )


def declare(package: Path, demonstrations: Path) -> tuple[Path, dict[str, str]]:
    """Write a package's file for recorded episodes, and return it with their digests.

    Raises:
        UserError: there is no such policy, or there are no such episodes; exit code 3.
    """
    from xpl.trajectory import TrajectoryError, open_folder

    if not (package / sdk.File.POLICY_YML).is_file():
        raise UserError(f"{package} holds no {sdk.File.POLICY_YML}", code=ExitCode.NOT_FOUND)
    try:
        trajectories = open_folder(demonstrations)
    except TrajectoryError as error:
        raise UserError(str(error), code=ExitCode.NOT_FOUND) from None
    root = demonstrations if demonstrations.is_dir() else demonstrations.parent
    digests = {Path(one.path).relative_to(root).as_posix(): digest(Path(one.path)) for one in trajectories}
    path = package / FILE
    relative = os.path.relpath(root.resolve(), package.resolve())
    write_file(path, render(Path(relative).as_posix(), digests).encode())
    return path, digests


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@cache
def _validator() -> Any:
    import jsonschema_rs

    path = content.content_folder("spec") / "demonstrations" / "demonstrations.schema.json"
    return jsonschema_rs.validator_for(json_text.parse(path.read_bytes()))
