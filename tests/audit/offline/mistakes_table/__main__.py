"""Runs trained.py in any Python: some libraries bring a package `tests` of their own, which would be found first."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[4]
sys.path.insert(0, str(ROOT))
holder = ModuleType("tests")
holder.__path__ = [str(ROOT / "tests")]
sys.modules["tests"] = holder
runpy.run_module("tests.audit.offline.mistakes_table.trained", run_name="__main__")
