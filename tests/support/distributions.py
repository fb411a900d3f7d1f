"""Distributions with entry points, installed by hand for the length of a test."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import registry
from xpl.catalogue import convention
from xpl.robots import registry as robots
from xpl_cli.audit.rules import registry as rules
from xpl_cli.model_io import mistakes
from xpl_cli.standard import spec, validate

if TYPE_CHECKING:
    import pytest

Install = Callable[[str, str, Mapping[str, str]], Path]


@contextmanager
def installing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Yield a function that installs a distribution: its name, the text of its entry points, and its files by path."""

    def install(name: str, points: str, files: Mapping[str, str]) -> Path:
        site = folder / f"site-{name}"
        about = f"{name}-1.0.dist-info"
        told = {
            **files,
            f"{about}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n",
            f"{about}/entry_points.txt": points,
        }
        for path, text in told.items():
            (site / path).parent.mkdir(parents=True, exist_ok=True)
            (site / path).write_text(text, encoding="utf-8")
        monkeypatch.syspath_prepend(site)
        forget()
        return site

    yield install
    monkeypatch.undo()
    forget()


def forget() -> None:
    """Have entry points looked for anew."""
    registry._installed.cache_clear()
    robots._bring.cache_clear()
    rules.entries.cache_clear()
    convention.installed.cache_clear()
    convention._conventions_by_key.cache_clear()
    spec.schema.cache_clear()
    validate._validator.cache_clear()
    validate.registry.cache_clear()
    mistakes._validator.cache_clear()
