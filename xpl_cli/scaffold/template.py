"""Templates of packages: location, questions and rendering."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli.basics.content import content_folder
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

Files = dict[str, bytes]


def template_folder(template: str) -> Path:
    """Return the folder of a template, named after its kind of package: `policy`, `env`."""
    return content_folder("templates") / template


def questions(template: str) -> dict[str, Any]:
    """Return the questions of a template: description by name of the answer."""
    config = spec.read_yaml(template_folder(template) / "copier.yml")
    return {key: entry for key, entry in config.items() if not key.startswith("_")}


def roles(template: str) -> dict[str, list[str]]:
    """Return which files must stay as rendered (`generated`), and which schemas are added (`schemas`)."""
    content: dict[str, list[str]] = spec.read_yaml(template_folder(template) / "roles.yml")
    return content


def render(
    template: str, context: Mapping[str, Any], leave_out: Sequence[str] = (), variant: str | None = None
) -> Files:
    """Render a template; deterministic in the context.

    Args:
        template: its name.
        context: its variables.
        leave_out: names of files to omit.
        variant: folder in `kinds/` whose files replace the template's; None for none.

    Returns:
        content by file name, relative to the package; sorted.
    """
    with _assembled(template_folder(template), variant) as source:
        return render_folder(source, context, leave_out)


def render_folder(source: Path, context: Mapping[str, Any], leave_out: Sequence[str] = ()) -> Files:
    """Render the template in a folder; deterministic in the context.

    Args:
        source: folder with a copier.yml.
        context: its variables.
        leave_out: names of files to omit.

    Returns:
        content by file name, relative to the package; sorted.
    """
    import copier
    from plumbum import local

    with (
        tempfile.TemporaryDirectory(prefix="xpl-render-") as folder,
        # Copier would call git for each file that it writes; the rendered files are in no repository.
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
    """Return a value as YAML."""
    import yaml

    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n").rstrip("\n")  # a bare scalar ends with a document mark


@contextmanager
def _assembled(template: Path, variant: str | None) -> Iterator[Path]:
    """Yield the folder of a template with the files of a variant copied over it."""
    over = template / "kinds" / (variant or "")
    if variant is None or not over.is_dir():
        yield template
        return
    with tempfile.TemporaryDirectory(prefix="xpl-template-") as folder:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(template, folder, dirs_exist_ok=True, ignore=ignored)
        shutil.copytree(over, Path(folder) / "files", dirs_exist_ok=True, ignore=ignored)
        yield Path(folder)
