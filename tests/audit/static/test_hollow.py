"""Scripts with nothing behind them: a fresh scaffold is told once, and told again when its places are filled in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.adapters.rules import made_adapter
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome, Result
from xpl_cli.audit.rules.options import Options

if TYPE_CHECKING:
    from pathlib import Path


def judged(adapter: Path) -> dict[str, Result]:
    """Return what the two rules about unfinished packages say."""
    options = Options(gates=(Gate.STATIC,), names=("placeholders", "hollow-scripts"))
    return {result.slug: result for result in engine.audit(adapter, "policy", options).results}


def test_a_fresh_scaffold_has_its_scripts_among_its_open_places(tmp_path: Path) -> None:
    """One warning, which names the files to write; the rule about scripts has nothing to add."""
    found = judged(made_adapter(tmp_path / "Foo"))
    (finding,) = found["placeholders"].findings
    assert finding.fix is not None
    assert "write process_data.py and train.py" in finding.fix.text
    assert finding.evidence is not None
    assert {"process_data.sh", "train.sh"} <= set(finding.evidence)
    assert found["hollow-scripts"].outcome is Outcome.NOT_APPLICABLE


def test_scripts_are_told_when_nothing_else_is_open(tmp_path: Path) -> None:
    """And no more when the author wrote what they run, or declares that there is nothing to train."""
    adapter = made_adapter(tmp_path / "Foo")
    for file in adapter.iterdir():
        if file.is_file():
            file.write_text(file.read_text().replace("XPL-PLACEHOLDER:", ""))
    found = judged(adapter)
    assert found["placeholders"].outcome is Outcome.PASS
    assert {finding.path for finding in found["hollow-scripts"].findings} == {"process_data.sh", "train.sh"}
    assert found["hollow-scripts"].outcome is Outcome.WARN
    (adapter / "train.py").write_text("from trainer import run\n\nrun()\n")
    assert {finding.path for finding in judged(adapter)["hollow-scripts"].findings} == {"process_data.sh"}
    manifest = adapter / "policy.yml"
    manifest.write_text(manifest.read_text().replace("evaluation_only: false", "evaluation_only: true"))
    assert judged(adapter)["hollow-scripts"].outcome is Outcome.PASS
