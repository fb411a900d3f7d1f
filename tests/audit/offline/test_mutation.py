"""The offline gate catches the defects of published adapters, planted one by one, and leaves correct adapters alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.audit.offline.mutation.mutants import MUTANTS, VARIANTS, Mutant
from tests.audit.offline.mutation.trial import SUBJECT, tried
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.options import AuditOptions

if TYPE_CHECKING:
    from pathlib import Path

SHARE = 0.95
ESCAPE = {
    "antipodal-differs": "no block says how its model was trained to take q and -q; then neither sign is wrong",
    "gripper-turned-round": "what is no copy of the observed gripper may mean anything; pairs and demonstrations tell",
    "will-not-end": "the server ends by force who ignores the signal, and nothing is left behind",
    "works-at-import": "the adapter finds its files from any working directory, so a change of it changes nothing",
}
"""Mutants that no rule catches, and why."""
SAMPLE = {
    "list-by-position",
    "instruction-of-the-first",
    "reset-keeps-the-history",
    "first-instruction-kept",
    "only-arrays-understood",
    "missing-camera-is-black",
    "instruction-ignored",
    "dual-keys-for-one-arm",
    "gripper-in-metres",
    "missing-step-loads-another",
}
"""One or two of each class for the quick tests, as far as they take seconds."""


def _cases(mutants: tuple[Mutant, ...], quick: set[str]) -> list[object]:
    return [
        pytest.param(mutant, id=mutant.name, marks=() if mutant.name in quick else pytest.mark.slow)
        for mutant in mutants
    ]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("mutant", _cases(MUTANTS, SAMPLE))
def test_a_planted_defect_is_caught(mutant: Mutant, tmp_path: Path) -> None:
    """Some rule of the offline gate finds something; those that escape are known, and few."""
    trial = tried(mutant, tmp_path)
    assert not trial.crashed
    assert (trial.rule is None) == (mutant.name in ESCAPE), trial


def test_few_planted_defects_escape() -> None:
    """What escapes is named with a reason; it is at most one in twenty, of at least fifty."""
    assert set(ESCAPE) <= {mutant.name for mutant in MUTANTS}
    assert len({mutant.name for mutant in MUTANTS}) == len({mutant.edits for mutant in MUTANTS}) == len(MUTANTS) >= 50
    assert 1 - len(ESCAPE) / len(MUTANTS) >= SHARE


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
def test_a_correct_adapter_is_left_alone_however_it_is_written(variant: Mutant, tmp_path: Path) -> None:
    """The whole offline gate is green: nothing found, nothing that could not run."""
    path = variant.plant(tmp_path / SUBJECT)
    (report,) = engine.audit(path, "policy", AuditOptions(gates=(Gate.OFFLINE,))).gates
    told = [(result.slug, result.reason, result.findings) for result in report.results]
    assert {result.outcome for result in report.results} <= {Outcome.PASS, Outcome.NOT_APPLICABLE}, told
    assert report.outcome is Outcome.PASS
