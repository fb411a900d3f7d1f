"""The static gate reads any folder: it runs nothing of it, survives what cannot be read, and says where things are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.adapters.rules import made_adapter
from tests.support.checkout import ROOT, tracked
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.static.manifests import delete_edits
from xpl_cli.audit.static.shell import parse
from xpl_cli.audit.static.source import Source

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """A fresh scaffold, to break."""
    return made_adapter(tmp_path / "Foo")


def audit(path: Path, *names: str) -> GateReport:
    return engine.audit(path, "policy", AuditOptions(gates=(Gate.STATIC,), names=names)).gates[0]


def outcomes(report: GateReport) -> dict[str, Outcome]:
    return {result.slug: result.outcome for result in report.results}


@pytest.mark.parametrize("name", sorted({path.parent.name for path in tracked("policy/*/policy.yml")}))
def test_our_own_policies_have_no_static_finding(name: str) -> None:
    """What is shipped keeps the rules that others are held against; who wrote model and reference.py has to assume."""
    report = audit(ROOT / "policy" / name)
    found = [(result.slug, finding.message) for result in report.results for finding in result.findings]
    assert [each for each in found if each[0] != "reference-sources"] == []


def test_a_syntax_error_is_found_once_and_blocks_only_what_needs_the_file(adapter: Path) -> None:
    """`parses` says where; rules about the class are not run; rules about other files are."""
    (adapter / "model.py").write_text("class Model:\n    def reset(self:\n        pass\n")
    report = audit(adapter)
    assert outcomes(report)["parses"] is Outcome.FAIL
    assert outcomes(report)["reset-incomplete"] is Outcome.NOT_RUN
    assert outcomes(report)["deploy-config"] is Outcome.PASS
    (finding,) = next(result.findings for result in report.results if result.slug == "parses")
    assert (finding.path, finding.line) == ("model.py", 2)
    assert report.outcome is Outcome.FAIL


def test_only_the_boundary_is_read(adapter: Path) -> None:
    """A vendored tree is left out, except for what model.py imports from it and process_data.sh calls."""
    for place in range(30):
        folder = adapter / "vendor" / f"part{place}"
        folder.mkdir(parents=True)
        (folder / "code.py").write_text("<<<<<<< HEAD\n")
    (adapter / "vendor/used.py").write_text("from vendor.part0 import code\n\nVALUE = 1\n")
    (adapter / "vendor/convert.py").write_text("VALUE = 2\n")
    with (adapter / "model.py").open("a") as model:
        model.write("\nfrom .vendor.used import VALUE\n")
    (adapter / "process_data.sh").write_text('ROOT="$(pwd)"\nTOOLS=${ROOT}/vendor\npython "${TOOLS}/convert.py" "$1"\n')
    source = Source(adapter)
    assert {name for name in source.files if name.startswith("vendor")} == {"vendor/used.py", "vendor/convert.py"}
    assert source.conversion_files == ("vendor/convert.py",)


def test_an_adapter_of_the_ecosystem_is_not_asked_for_our_manifest(adapter: Path) -> None:
    """Without policy.yml: no training scripts, no manifest, imports at the top of model.py."""
    for name in ("policy.yml", "process_data.sh", "train.sh"):
        (adapter / name).unlink()
    (adapter / "model.py").write_text(
        "import torch\n\nfrom framework.model_template import ModelTemplate\n\n\n"
        "class Model(ModelTemplate):\n"
        "    def __init__(self, model_cfg):\n        self.store = {}\n\n"
        "    def update_obs(self, obs):\n        self.update_obs_batch([obs])\n\n"
        "    def update_obs_batch(self, obs_list):\n"
        "        self.store = {obs.get('env_idx', place): obs for place, obs in enumerate(obs_list)}\n\n"
        "    def get_action(self):\n        return self.get_action_batch()[0]\n\n"
        "    def get_action_batch(self, env_idx_list=None):\n"
        "        wanted = self.store if env_idx_list is None else env_idx_list\n"
        "        return [self.model(self.store[env]) for env in wanted]\n\n"
        "    def reset(self):\n        self.store = {}\n"
    )
    report = audit(adapter)
    assert outcomes(report)["manifest"] is Outcome.NOT_APPLICABLE
    assert outcomes(report)["heavy-imports"] is Outcome.NOT_APPLICABLE
    assert report.outcome is Outcome.PASS, [result for result in report.results if result.findings]


def test_places_count_characters_from_one(adapter: Path) -> None:
    with (adapter / "model.py").open("a", encoding="utf-8") as model:
        model.write("\n    def load(self, config):\n        self.schön = 'äöü'; self.flag = bool(config['flag'])\n")
    lines = (adapter / "model.py").read_text(encoding="utf-8").split("\n")
    report = audit(adapter, "flag-from-text")
    (finding,) = report.results[0].findings
    assert finding.line is not None
    assert finding.column is not None
    assert lines[finding.line - 1][finding.column - 1 :].startswith("bool(config")
    assert finding.end_column == finding.column + len("bool(config['flag'])")


@pytest.mark.parametrize(
    ("script", "commands"),
    [
        ("a b # c\nd", [["a", "b"], ["d"]]),
        ('a \'b # c\' "d $(e "f g") h"', [["a", "'b # c'", '"d $(e "f g") h"']]),
        ("cat <<'EOF' && b\nseed=$5\nEOF\nc", [["cat"], ["b"], ["c"]]),
        ("cat <<<word; b", [["cat"], ["b"]]),
        ("a \\\n  b", [["a", "b"]]),
        ("a >log 2>&1 &\nb", [["a"], ["b"]]),
        ("args=(a 'b c' d)\ne", [["args=(a 'b c' d)"], ["e"]]),
        ("if a; then b; else c; fi", [["a"], ["b"], ["c"]]),
        ("x=${1:-${2:-a b}} c", [["x=${1:-${2:-a b}}", "c"]]),
        ("(( n < 3 )) && a", [["((", "n < 3"], ["a"]]),
        ("a 'unclosed\nb", [["a"]]),
    ],
)
def test_scripts_are_parsed_into_commands(script: str, commands: list[list[str]]) -> None:
    assert [[word.raw for word in command.words] for command in parse(script)] == commands


def test_words_know_their_place_and_position() -> None:
    commands = parse("set -e\n  seed=${6:-0}\nf() {\n  local a=$1\n}\nuntil b; do sleep 1; done\nsleep 2\n")
    (name, word) = commands[1].assignments[0]
    assert (name, word.position, word.line, word.column) == ("seed", 6, 2, 8)
    assert [(command.name, command.functions) for command in commands if command.functions] == [("local", 1)]
    assert [command.loops for command in commands if command.name == "sleep"] == [1, 0]


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("a: 1\nb: 2 # two\nc: 3\n", "a: 1\nc: 3\n"),
        ("a: 1\nb:\n  - x\n  - y: [1,\n      2]\n# about c\nc: 3\n", "a: 1\n# about c\nc: 3\n"),
        ("a: 1\nb: |\n  text\n  more\nc: 3\n", "a: 1\nc: 3\n"),
        ("a: 1\nb: 2", "a: 1\n"),
    ],
)
def test_a_key_is_deleted_with_its_value_and_nothing_else(tmp_path: Path, before: str, after: str) -> None:
    (tmp_path / "deploy.yml").write_text(before)
    lines = before.split("\n")
    (edit,) = delete_edits(Source(tmp_path), "deploy.yml", "b")
    text = "\n".join(lines[: edit.line - 1]) + "\n"
    rest = lines[edit.end_line - 1 :]
    rest[0] = rest[0][edit.end_column - 1 :]
    assert text + "\n".join(rest) == after
