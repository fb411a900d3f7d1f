"""Conversions of small sets in this process: a pool of processes takes longer than they do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from tests.data import datasets
from xpl_cli.basics import parallel
from xpl_cli.basics.progress import Progress
from xpl_cli.data.conversion import job
from xpl_cli.data.formats.writing import WriteOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@pytest.fixture(scope="session")
def libero(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file of LIBERO's form."""
    return datasets.libero(tmp_path_factory.mktemp("sets") / "bowl_demo.hdf5")


@pytest.fixture(scope="module")
def converted() -> Iterator[Callable[..., job.ConversionReport]]:
    """Return what converts a set in this process."""

    def convert(source: Path, target: Path, to: str, **how: Any) -> job.ConversionReport:
        options = {name: how.pop(name) for name in ("images", "codec", "crf", "file_mb") if name in how}
        return job.convert(job.ConversionJob(source, target, to, options=WriteOptions(**options), **how), Progress())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parallel, "map_in_processes", lambda each, items, _workers: map(each, items))
        patch.setattr(parallel, "end_with_parent", lambda _parent: None)
        yield convert
