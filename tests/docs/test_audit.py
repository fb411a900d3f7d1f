"""The examples of docs/audit.md and docs/ci.md work."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.adapters.rules import made_adapter
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl.manifest import Manifest
from xpl_cli.basics.errors import ExitCode
from xpl_cli.standard.validate import validate

PAGE = (ROOT / "docs" / "audit.md").read_text(encoding="utf-8")
CI = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")


def blocks(language: str, page: str = PAGE) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL)


def commands(text: str) -> list[list[str]]:
    return [shlex.split(line, comments=True)[1:] for line in text.splitlines() if line.startswith("xpl ")]


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    (tmp_path / "policy").mkdir()
    made_adapter(tmp_path / "policy" / "Foo")
    return tmp_path


def _examples() -> Iterator[Any]:
    """Yield every example; rollouts have fewer episodes in the quick run, and recordings are slow."""
    for number, example in enumerate(blocks("console")):
        if "xpl record" in example:
            yield pytest.param(example, id=f"{number}", marks=pytest.mark.slow)
            continue
        shorter = re.sub(r"--episodes \d+", "--episodes 1", example)
        yield pytest.param(shorter, id=f"{number}")
        if shorter != example:
            yield pytest.param(example, id=f"{number} as it stands", marks=pytest.mark.slow)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("example", list(_examples()))
def test_every_command_of_the_page_runs(workspace: Path, example: str) -> None:
    page_commands = commands(example)
    assert page_commands
    for command in page_commands:
        done = xpl(*command, cwd=workspace)
        assert done.returncode == ExitCode.CLEAN, (command, done.stderr)


def test_the_waiver_of_the_page_waives(workspace: Path) -> None:
    folder = workspace / "policy" / "Foo"
    with (folder / "eval.sh").open("a") as script:
        script.write("\nsleep 5\n")
    options = ("policy/Foo", "--gate", "static", "--select", "fixed-sleep", "--select", "stale-waiver", "--json")
    before = json.loads(xpl("audit", *options, cwd=workspace).stdout)
    assert before["summary"]["warn"] + before["summary"]["fail"] == 1
    (example,) = (block for block in blocks("yaml") if "waivers" in block)
    with (folder / "policy.yml").open("a") as manifest:
        manifest.write(example)
    after = json.loads(xpl("audit", *options, cwd=workspace).stdout)
    results = after["targets"][0]["gates"][0]["results"]
    assert [len(result["findings"]) for result in results] == [0, 0]
    reasons = [waived["reason"] for result in results for waived in result["waived"]]
    assert reasons == [yaml.safe_load(example)["waivers"][0]["reason"]]


def test_the_claim_of_the_page_is_one(workspace: Path) -> None:
    (example,) = (block for block in blocks("yaml") if "claims" in block)
    manifest = (workspace / "policy" / "Foo" / "policy.yml").read_text()
    assert validate(yaml.safe_load(manifest + example), "policy") == []
    assert Manifest.parse(yaml.safe_load(example)).claims


def test_the_page_on_integration_uses_the_action_that_is_there() -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    examples = [yaml.safe_load(example) for example in blocks("yaml", CI)]
    steps = examples[0]["jobs"]["audit"]["steps"]
    local = [ROOT / step["uses"] for step in steps if step["uses"].startswith(".")]
    assert [(folder / "action.yml").is_file() for folder in local] == [True]
    rows = set(re.findall(r"`([a-z-]+)`", "".join(re.findall(r"^\| `.*?\|", CI, flags=re.MULTILINE))))
    assert rows == set(action["inputs"]) | set(action["outputs"])
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
    assert hook["id"] in CI
