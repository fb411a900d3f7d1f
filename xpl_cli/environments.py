"""Environment packages: found by name, loaded by path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli import content, spec
from xpl_cli.errors import NotFoundError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import ModuleType


def find(name: str) -> Path:
    """Return the folder of an environment package: a path, a name below `envs/` of the working directory, or ours.

    Raises:
        NotFoundError: with the names that there are.
    """
    rooms = (Path("envs"), content.room("envs"))
    for candidate in (Path(name), *(place / name for place in rooms)):
        if (candidate / "env.yml").is_file():
            return candidate.resolve()
    names = sorted({entry.parent.name for place in rooms for entry in place.glob("*/env.yml")})
    raise NotFoundError(f"there is no environment {name!r}; there are: {', '.join(names)}")


def manifest(folder: Path) -> dict[str, Any]:
    """Return the map in an environment's env.yml."""
    value: dict[str, Any] = spec.read_yaml(folder / "env.yml")
    return value


def module(name: str, part: str = "client") -> ModuleType:
    """Load one module of an environment package."""
    return content.load_module(find(name) / f"{part}.py")


def make(name: str, config: Mapping[str, Any]) -> Any:
    """Return a task environment."""
    return module(name).make(config)
