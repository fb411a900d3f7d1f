"""What the reader of syntax trees says of the SDK is what Python finds when it imports it."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from xpl_cli.audit.static.names import offered
from xpl_cli.audit.static.names.offered import Missing, Module

MODULES = offered.sdk_modules()


@pytest.mark.sampled(30)
@pytest.mark.parametrize("name", MODULES)
def test_a_module_of_the_sdk_offers_what_it_has_when_it_is_imported(name: str) -> None:
    """Each name that is there is read as one, and each that is read is there; what is private to Python aside."""
    module = importlib.import_module(name)
    found = offered.located(offered.sdk_root(), name.split(".")[1:])
    assert isinstance(found, Module)
    assert found.file is not None
    offer = offered.sdk_offer(found.file)
    submodules = {other.rpartition(".")[2] for other in MODULES if other.rpartition(".")[0] == name}
    there = {entry for entry in vars(module) if not (entry.startswith("__") and entry.endswith("__"))}
    assert there - submodules - {"_spec"} <= offer.names
    assert [entry for entry in offer.names if not hasattr(module, entry)] == []


def test_a_home_is_a_module_that_has_the_name() -> None:
    """What a finding tells to import can be imported."""
    homes = offered.sdk_homes()
    assert homes["get_image"] == "xpl.observation"
    assert homes["Client"] == "xpl"
    assert all(hasattr(importlib.import_module(module), name) for name, module in homes.items())


def test_dotted_names_lead_to_files_folders_and_nowhere(tmp_path: Path) -> None:
    """A compiled module and another project's tree are neither there nor missing: nobody can know."""
    for name in ("pack/__init__.py", "pack/deep.py", "spread/one.py", "taken/setup.py", "fast.cpython-311.so"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "unfetched").mkdir()
    assert offered.located(tmp_path, ["pack", "deep"]) == Module(tmp_path / "pack" / "deep.py", None)
    assert offered.located(tmp_path, ["spread"]) == Module(None, tmp_path / "spread")
    assert offered.located(tmp_path, ["pack", "dep"]) == Missing("dep", tmp_path / "pack")
    assert offered.located(tmp_path, ["pack", "deep", "er"]) == Missing("er", None)
    assert [offered.located(tmp_path, [name]) for name in ("fast", "taken", "unfetched")] == [None, None, None]
