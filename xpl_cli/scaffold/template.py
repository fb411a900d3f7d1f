"""Templates of packages: where one lies, what it asks for, and how its files come out of it."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli.basics.content import room
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

Files = dict[str, bytes]


def place(template: str) -> Path:
    """Return the folder of a template; its name is the kind of package that it makes: `policy`, `env`."""
    return room("templates") / template


def questions(template: str) -> dict[str, Any]:
    """Return what a template asks for: name of the answer to its description."""
    config = spec.read_yaml(place(template) / "copier.yml")
    return {key: entry for key, entry in config.items() if not key.startswith("_")}


def roles(template: str) -> dict[str, list[str]]:
    """Return which files stay as they are rendered (`generated`), and which schemas go with them (`schemas`)."""
    found: dict[str, list[str]] = spec.read_yaml(place(template) / "roles.yml")
    return found


def render(
    template: str, context: Mapping[str, Any], leave_out: Sequence[str] = (), variant: str | None = None
) -> Files:
    """Render a template; the same context always gives the same bytes.

    Args:
        template: its name.
        context: all that it may say.
        leave_out: names of files that are not wanted.
        variant: folder in `kinds/` whose files take the place of the template's; None for none.

    Returns:
        file name, relative to the package, to content; sorted.
    """
    with _assembled(place(template), variant) as source:
        return render_folder(source, context, leave_out)


def render_folder(source: Path, context: Mapping[str, Any], leave_out: Sequence[str] = ()) -> Files:
    """Render the template in a folder; the same context always gives the same bytes.

    Args:
        source: folder with a copier.yml.
        context: all that it may say.
        leave_out: names of files that are not wanted.

    Returns:
        file name, relative to the package, to content; sorted.
    """
    import copier
    from plumbum import local

    with (
        tempfile.TemporaryDirectory(prefix="xpl-render-") as folder,
        # Copier would ask git about each file that it writes, and what is rendered here lies in no repository.
        local.env(PATH=""),
    ):
        copier.run_copy(
            str(source),
            folder,
            data=dict(context),
            settings=copier.Settings(),  # nothing from the user's own copier settings
            exclude=leave_out,
            defaults=True,
            quiet=True,
            skip_tasks=True,
        )
        root = Path(folder)
        paths = sorted(path for path in root.rglob("*") if path.is_file())
        return {path.relative_to(root).as_posix(): path.read_bytes() for path in paths}


def as_yaml(value: object) -> str:
    """Return a value as it is written in YAML."""
    import yaml

    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n").rstrip("\n")  # a bare scalar ends with a document mark


@contextmanager
def _assembled(template: Path, variant: str | None) -> Iterator[Path]:
    """Give the folder of a template with the files of a variant in it."""
    over = template / "kinds" / (variant or "")
    if variant is None or not over.is_dir():
        yield template
        return
    with tempfile.TemporaryDirectory(prefix="xpl-template-") as folder:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(template, folder, dirs_exist_ok=True, ignore=ignored)
        shutil.copytree(over, Path(folder) / "files", dirs_exist_ok=True, ignore=ignored)
        yield Path(folder)
