"""Files that a generator made hostile (`hostile.py`): reading them ends in a value, or in one error that names a file.

What it found is kept as cases of `test_sets.py` and `test_checkpoints.py`; bundles, records, texts and frames have
generators of their own beside their tests.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.attacks import hostile
from tests.attacks.test_checkpoints import MAKERS
from tests.attacks.test_sets import everything
from tests.data import datasets
from xpl_cli.adopt.checkpoints import registry
from xpl_cli.basics.errors import ExitCode, UserError

SETS: dict[str, Callable[[Path], Any]] = {
    "libero.hdf5": datasets.libero,
    "robotwin": datasets.robotwin,
    "episode_0.hdf5": datasets.aloha,
    "standard.hdf5": datasets.standard,
    "diffusion.zarr": datasets.diffusion_policy,
    "lerobot21": datasets.lerobot_v21,
    "lerobot30": datasets.lerobot_v30,
}


def _checkpoint(path: Path) -> None:
    registry.read([path])


CASES = {name: (make, everything) for name, make in SETS.items()} | {
    maker: (make, _checkpoint) for maker, make in MAKERS.items()
}
ENDS = (ExitCode.FINDINGS, ExitCode.USAGE, ExitCode.NOT_FOUND)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with one honest file or folder of each format."""
    folder = tmp_path_factory.mktemp("sound")
    for name, (make, reads) in CASES.items():
        make(folder / name)
        reads(folder / name)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", CASES)
@settings(max_examples=60, suppress_health_check=list(HealthCheck), deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_read_or_one_error(sound: Path, name: str, data: st.DataObject) -> None:
    _, reads = CASES[name]
    with tempfile.TemporaryDirectory(prefix="xpl-hostile-") as folder:
        path = Path(folder) / name
        copy = shutil.copytree if (sound / name).is_dir() else shutil.copyfile
        copy(sound / name, path)
        hostile.damage(data.draw, path)
        told, code = "", ExitCode.CLEAN
        try:
            reads(path)
        except UserError as error:
            told, code = str(error), error.code
        assert not told or (str(path) in told and code in ENDS), told
