"""`xpl audit POLICY --demos PATH`: what comes of a policy as trained, of a mistake, and where nothing can be told."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support import forked
from xpl_cli.audit.engine import fixtures
from xpl_cli.audit.offline.demonstrations import declaration
from xpl_cli.audit.rules.registry import find
from xpl_cli.basics.errors import ExitCode

if TYPE_CHECKING:
    import subprocess

RULE = "demonstrations-fit"


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two policies of one model, of which Wrong has red for blue, and six episodes beside them that neither names."""
    root = tmp_path_factory.mktemp("told")
    fixtures_by_name = {subject.name: subject for subject in fixtures.fixtures(find(RULE))}
    for name, subject in (("Right", "good/as-trained"), ("Wrong", "bad/blue-for-red")):
        package = fixtures.build(fixtures_by_name[subject], root / name)
        (package / declaration.FILE).unlink()
        shutil.rmtree(root / "demos", ignore_errors=True)
        (package / "demonstrations").rename(root / "demos")
    return root


def _audit(workspace: Path, name: str, *options: str) -> subprocess.CompletedProcess[str]:
    gate = ("--gate", "offline", "--select", RULE, "--no-cache")
    return forked.run("audit", name, *gate, *options, cwd=workspace)


def _result(ran: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """Return the rule's result in a JSON report."""
    (package,) = json.loads(ran.stdout)["targets"]
    return next(results for gate in package["gates"] for results in gate["results"] if results["slug"] == RULE)


def test_a_mistake_is_named_in_every_form_and_drawn(workspace: Path) -> None:
    """One audit: the convention that fits, in the JSON and the SARIF report, with a picture that a browser opens."""
    written = ("--json", "--output", "sarif=found.sarif", "--pictures", "pictures")
    ran = _audit(workspace, "Wrong", "--demos", "demos", *written)
    assert ran.returncode == ExitCode.FINDINGS, ran.stderr
    (finding,) = _result(ran)["findings"]
    assert finding["evidence"]["cause"]["words"] == "channels: rgb"
    assert finding["path"] == "Wrong/policy.yml"
    picture = (workspace / "pictures" / f"Wrong-{RULE}.svg").read_text(encoding="utf-8")
    assert finding["evidence"]["file"] == f"pictures/Wrong-{RULE}.svg"
    assert picture.startswith("<svg")
    (result,) = json.loads((workspace / "found.sarif").read_text(encoding="utf-8"))["runs"][0]["results"]
    assert (result["ruleId"], result["level"]) == ("XPL270", "error")
    assert "channels: rgb" in result["message"]["text"]


@pytest.mark.slow
def test_a_policy_as_it_was_trained_is_green_and_says_by_how_many_episodes(workspace: Path) -> None:
    """The verdict's statement counts them, and the proof has the errors of the witnesses."""
    ran = _audit(workspace, "Right", "--demos", "demos", "--json")
    assert ran.returncode == ExitCode.CLEAN, ran.stderr
    result = _result(ran)
    assert (result["outcome"], result["proof"]["episodes"]) == ("pass", 6)
    assert result["proof"]["error"] < result["proof"]["error of holding the pose"]
    assert "demonstrations (6 episodes)" in json.loads(ran.stdout)["targets"][0]["statement"]


@pytest.mark.slow
def test_episodes_that_differ_from_the_declared_ones_are_not_used(workspace: Path, tmp_path: Path) -> None:
    """`xpl data declare` writes digests; as long as they hold the audit looks without `--demos`, and then no more."""
    package, demos = tmp_path / "Right", tmp_path / "demos"
    shutil.copytree(workspace / "Right", package)
    shutil.copytree(workspace / "demos", demos)
    assert forked.run("data", "declare", package, demos).returncode == ExitCode.CLEAN
    assert _result(_audit(tmp_path, "Right", "--json"))["outcome"] == "pass"
    changed = sorted(demos.glob("*.hdf5"))[2]
    changed.write_bytes(changed.read_bytes() + b"\0")
    ran = _audit(tmp_path, "Right", "--json")
    assert ran.returncode == ExitCode.NOT_RUN
    assert f"{changed.name} differ" in _result(ran)["reason"]
