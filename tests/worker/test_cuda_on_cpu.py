from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.support.checkout import ROOT
from xpl.worker import cuda_on_cpu

DRIVER = Path(__file__).with_name("cuda_on_cpu_driver.py")
PYTHONS = (os.environ.get("XPL_TORCH_PYTHON"), str(ROOT / "policy" / "Tiny_VLA" / ".venv" / "bin" / "python"))
TRIES = (
    "moves_tensors",
    "moves_modules",
    "makes_tensors",
    "copies_foreign_memory",
    "copies_results",
    "enters_modes",
    "casts",
    "draws",
    "loads",
    "loads_safetensors",
    "avoids_flash_attention",
    "scripts",
    "asks_the_gpu",
    "works_in_threads",
    "keeps_other_devices",
)


@pytest.fixture(scope="module", params=["early", "late"])
def results(request: pytest.FixtureRequest) -> dict[str, object]:
    """Return what the tries returned, redirected before or after the libraries are imported."""
    python = next((one for one in PYTHONS if one and Path(one).is_file()), None)
    if python is None:
        pytest.skip("no Python with torch: `xpl install policy/Tiny_VLA`, or name one in XPL_TORCH_PYTHON")
    run = subprocess.run([python, str(DRIVER), str(ROOT), request.param], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert set(found) == set(TRIES)
    return found


@pytest.mark.parametrize("name", TRIES)
def test_code_that_names_cuda_runs_on_the_cpu(results: dict[str, object], name: str) -> None:
    assert results[name] in (True, "no safetensors", "no transformers")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("cuda", "cpu"),
        ("cuda:12", "cpu"),
        ("cuda:x", "cuda:x"),
        ({"": "cuda:0", "head": 1}, {"": "cpu", "head": 1}),
        (None, None),
    ],
)
def test_only_names_of_gpus_become_the_cpu(value: object, expected: object) -> None:
    assert cuda_on_cpu._on_cpu(value) == expected
