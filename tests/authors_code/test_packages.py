"""Packages over their authors' code, on tiny random weights: served, and compared with the authors' own pipeline.

Three are in the quick run. All others are tried by one slow command, each where its environment is:

    ./dev xpl install policy/NAME && ./dev test slow tests/authors_code
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest

from tests.client.interop import build
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl_cli.basics.errors import UserError
from xpl_cli.lifecycle import interpreter
from xpl_cli.model_io import names, recipes
from xpl_cli.packages.package import load

if TYPE_CHECKING:
    from pathlib import Path

_LEROBOT = "lerobot"
_QUICK = ("LeRobot", "LeRobot:diffusion", "LeRobot:vqbet")
_NEEDS_OVERLAY = ("LeRobot:pi0", "LeRobot:pi05", "LeRobot:pi0_fast")
_RULES = ("serves", "action-structure", "reset-forgets", "golden-parity")


@dataclass(frozen=True)
class Subject:
    """A package, or one of its variants."""

    package: str
    variant: str | None = None

    @property
    def name(self) -> str:
        """Its name, as PACKAGE or PACKAGE:VARIANT."""
        return self.package if self.variant is None else f"{self.package}:{self.variant}"

    @property
    def python(self) -> str | None:
        """The interpreter with its libraries; None where it was not installed."""
        manifest = load(ROOT / "policy" / self.package).manifest
        try:
            return interpreter.resolve(ROOT / "policy" / self.package, manifest.environment)
        except UserError:
            peer = build.interpreter(_LEROBOT, locks=build.AUTHORS_CODE)
            is_enough = self.package == "LeRobot" and self.name not in _NEEDS_OVERLAY
            return str(peer) if is_enough and peer is not None else None


def _subjects() -> list[Any]:
    found = []
    for code in sorted((ROOT / "policy").glob(f"*/{recipes.CODE}")):
        if not (code.parent / names.CODE).is_file():
            continue
        variants = load(code.parent).manifest.data.get("variants", {})
        found += [Subject(code.parent.name), *(Subject(code.parent.name, variant) for variant in variants)]
    return [pytest.param(one, id=one.name, marks=() if one.name in _QUICK else pytest.mark.slow) for one in found]


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("subject", _subjects())
def test_it_answers_as_its_authors_code(subject: Subject, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every golden pair of the tiny weights is met, within the block's tolerance."""
    python = subject.python
    if python is None:
        pytest.skip(f"not run: policy/{subject.package} is not installed here (./dev peers, or xpl install)")
    monkeypatch.setenv("XPL_CACHE", str(tmp_path))
    arguments = ["audit", f"policy/{subject.package}", "--gate", "offline", "--python", python]
    arguments += [word for rule in _RULES for word in ("--select", rule)]
    arguments += [] if subject.variant is None else ["--set", f"variant={subject.variant}"]
    report = json.loads(xpl(*arguments, "--json", cwd=ROOT).stdout)
    (target,) = report["targets"]
    outcomes = {result["slug"]: result["outcome"] for gate in target["gates"] for result in gate["results"]}
    assert outcomes == dict.fromkeys(_RULES, "pass")
    assert "tiny random weights" in target["statement"]
