"""`benchmarks/learned.py`: one command makes a policy of the table, and goes on where it was stopped."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from benchmarks import learned
from tests.support.adapters.learned import needed, small
from tests.support.checkout import ROOT

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("which", learned.RECIPES, ids="-".join)
def test_every_recipe_records_prepares_trains_and_judges(which: tuple[str, str], tmp_path: Path) -> None:
    """With what its package reads: cameras, or what the simulator tells."""
    policy, task = which
    arguments = learned.parse_arguments(["--policy", policy, "--task", task])
    package, _, variant = policy.partition(":")
    all_stages = list(learned.stages(learned.RECIPES[which], ROOT / "policy" / package, tmp_path, arguments))
    names = [stage.words[0] for stage in all_stages]
    assert list(dict.fromkeys(names)) == ["record", "install", "prepare", "train", "eval", "report"]
    assert [name for name in names if name in ("prepare", "train")] == ["prepare", "train"]
    recorded = " ".join(all_stages[0].words)
    assert ("--images none" in recorded) == (variant == "state")
    chosen = {"variant=state" in stage.words for stage in all_stages if stage.words[0] in ("prepare", "train", "eval")}
    assert chosen == {variant == "state"}
    assert (ROOT / "policy" / package).is_dir()


def test_who_reads_is_judged_with_other_instructions_too(tmp_path: Path) -> None:
    policy, task = "Tiny_VLA", "pick_by_language"
    arguments = learned.parse_arguments(["--policy", policy, "--task", task])
    all_stages = learned.stages(learned.RECIPES[policy, task], tmp_path, tmp_path, arguments)
    judged = [stage.words for stage in all_stages if stage.words[0] == "eval"]
    instructions = [words[words.index("--instruction") + 1] if "--instruction" in words else None for words in judged]
    assert instructions == [None, None, "swap", "swap", "blank"]
    assert len({words[words.index("--out") + 1] for words in judged}) == 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--policy", "ACT"], "go together"),
        (["--policy", "ACT", "--task", "mw-push"], "lift_cube, push_block"),
        (["--policy", "Foo", "--task", "lift_cube"], "DiffusionPolicy:state"),
    ],
)
def test_what_there_is_not_is_refused_with_what_there_is(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        learned.parse_arguments(words)
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def test_it_goes_on_after_what_is_done_and_never_with_other_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stage that failed is the next one; other settings in the same folder are an error."""
    codes = {"train": 4}
    called: list[str] = []

    def ran(command: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
        words = command[len(learned.XPL) :]
        called.append(words[0])
        if words[0] == "report":
            learned_report = tmp_path / "runs" / words[1].rpartition("/")[2] / "report"
            learned_report.mkdir(parents=True)
            (learned_report / "report.json").write_text("{}")
        return subprocess.CompletedProcess(command, codes.get(words[0], 0))

    monkeypatch.setattr(subprocess, "run", ran)
    recipe = learned.RECIPES["ACT:state", "lift_cube"]
    given = ["--policy", "ACT:state", "--task", "lift_cube", "--out", str(tmp_path), "--judge", "2"]
    arguments = learned.parse_arguments(given)
    with pytest.raises(SystemExit, match="train ended with exit code 4"):
        learned.run(recipe, arguments)
    codes.clear()
    assert called == ["record", "install", "prepare", "train"]
    result = learned.run(recipe, arguments)
    assert called[4:] == ["train", "eval", "report"]
    assert set(result["reports"]) == {"clean"}
    with pytest.raises(SystemExit, match="other settings"):
        learned.run(recipe, learned.parse_arguments([*given[:-1], "3"]))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@needed
def test_a_policy_is_made_by_one_command(tmp_path: Path) -> None:
    """Three demonstrations, some steps, one episode: nothing stands in for anything."""
    pytest.importorskip("mujoco")
    folder = small(tmp_path, "ACT")
    words = ["--policy", "ACT:state", "--task", "lift_cube", "--package", str(folder), "--out", str(tmp_path / "out")]
    few = ["--episodes", "3", "--steps", "100", "--judge", "1", "--workers", "1", "--installed"]
    file = tmp_path / "figures.json"
    command = [sys.executable, "benchmarks/learned.py", *words, *few, "--json", str(file)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(file.read_text(encoding="utf-8"))
    assert result == json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert set(result["seconds"]) == {"record clean", "prepare", "train", "judge clean", "report clean"}
    assert result["reports"]["clean"]["schema"] == "xpl.report/1"
    assert (folder / "checkpoints" / "learned-state-lift_cube" / "model.safetensors").is_file()
