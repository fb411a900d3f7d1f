"""An audit without weights uses the package's tiny.py, and what reference.py answers with these weights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from tests.support.adapters import parity
from xpl_cli.audit.engine.engine import audit
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.rules.verdict import PARITY, VerdictStatus, verdict_of
from xpl_cli.basics import user_cache
from xpl_cli.basics.progress import Progress
from xpl_cli.packages.package import POLICY

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.rules.model import TargetReport

MODEL = parity.MODEL.replace("from xpl import Policy\n", "from xpl import Policy\nfrom xpl.checkpoint import resolve\n")
MODEL = MODEL.replace(
    "self.network = Network()",
    'self.network, self.scale = Network(), np.load(resolve(config, self.policy_dir) / "scale.npy")',
).replace("self.network(*row)", "self.scale * self.network(*row)")
REFERENCE = parity.REFERENCE.replace(
    "network = Network()",
    'network, scale = Network(), np.load(__import__("pathlib").Path(config["ckpt_name"]) / "scale.npy")',
).replace("said = network(", "said = scale * network(")
RECIPE = """\
import numpy as np


def write(folder, gain, config):
    np.save(folder / "scale.npy", np.random.default_rng(0).uniform(0.5, 0.9, 8))
"""


def _audit(
    folder: Path,
    block: dict[str, Any] = parity.BLOCK,
    recipe: str | None = RECIPE,
    model: str = MODEL,
    code: str = REFERENCE,
    **options: Any,
) -> TargetReport:
    if not folder.exists():
        parity.write_adapter(folder, block, model=model, code=code)
        if recipe is not None:
            (folder / "tiny.py").write_text(recipe)
    names = ("serves", "golden-parity", "golden-provenance")
    return audit(folder, POLICY, AuditOptions(gates=(Gate.STATIC, Gate.OFFLINE), names=names, **options))


def _outcome(report: TargetReport, code: str) -> Outcome:
    return next(result.outcome for result in report.results if result.code == code)


def test_missing_weights_are_made_and_compared_with_the_authors_code(tmp_path: Path) -> None:
    report = _audit(tmp_path / "Foo")
    verdict = verdict_of(report)
    assert verdict.status is VerdictStatus.OPEN, str(verdict)  # the README of a scaffold has places to fill in
    assert "tiny random weights" in str(verdict)
    assert PARITY in [item.claim for item in verdict.proven]
    assert sorted(path.name for path in (tmp_path / "Foo").iterdir() if path.name.startswith(("golden", "check"))) == []
    made = next((user_cache.folder() / "tiny").glob("Foo-*"))
    stamp = (made / "scale.npy").stat().st_mtime_ns
    again = _audit(tmp_path / "Foo")
    assert (made / "scale.npy").stat().st_mtime_ns == stamp
    assert [gate.digest for gate in again.gates] == [gate.digest for gate in report.gates]


def test_a_mistake_is_red_with_tiny_weights(tmp_path: Path) -> None:
    wrong = parity.block(images=[{**parity.BLOCK["images"][0], "channels": "rgb"}])
    report = _audit(tmp_path / "Foo", wrong)
    assert _outcome(report, "XPL260") is Outcome.FAIL
    assert verdict_of(report).status is VerdictStatus.RED


@pytest.mark.parametrize(("recipe", "options"), [(None, {}), (RECIPE, {"profile": Profile.SHADOW})])
def test_without_a_recipe_or_in_shadow_mode_no_weights_are_made(
    tmp_path: Path, recipe: str | None, options: dict[str, Any]
) -> None:
    report = _audit(tmp_path / "Foo", recipe=recipe, **options)
    verdict = str(verdict_of(report))
    assert "without the model" in verdict
    assert "tiny" not in verdict


def test_a_recipe_that_fails_leaves_the_audit_as_it_is_without(tmp_path: Path) -> None:
    report = _audit(tmp_path / "Foo", recipe="def write(folder, gain, config):\n    raise KeyError('hub')\n")
    assert "without the model" in str(verdict_of(report))


def test_a_reference_that_fails_is_reported_and_the_weights_are_tiny_all_the_same(tmp_path: Path) -> None:
    reported: list[str] = []
    report = _audit(tmp_path / "Foo", code="import nowhere\n" + REFERENCE, progress=Progress(step=reported.append))
    assert _outcome(report, "XPL260") is Outcome.NOT_RUN
    assert report.circumstances.weights == "tiny random weights"
    assert [text for text in reported if "nowhere" in text]


def test_inputs_that_tiny_weights_ignore_are_in_the_verdict(tmp_path: Path) -> None:
    """The network is told nothing of the instruction."""
    report = _audit(tmp_path / "Foo", model=MODEL.replace("(*row)", '(row[0], row[1], "")'))
    assert report.circumstances.weights == "tiny random weights, which ignore instruction"
    assert _outcome(report, "XPL260") is Outcome.FAIL
