"""`xpl adopt`: what it reads of an adapter, what it leaves open, and what it never touches."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.adapters.adopted import DEPLOY, FILES, MODEL, written
from tests.support.examples import examples
from tests.support.peer import xpl
from tests.support.places import ROOT
from xpl_cli.adopt import infer, manifest
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.standard import spec
from xpl_cli.standard.validate import validate_yaml_file

PAGE = (ROOT / "docs" / "adopt.md").read_text(encoding="utf-8")


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """An adapter of the ecosystem."""
    return written(tmp_path / "Grasp")


def read(folder: Path, **given_: Any) -> dict[str, Any]:
    """Return the manifest that adoption would write, as a map."""
    return yaml.safe_load(manifest.text(infer.draft(Source(folder), given_)))


def state(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Return contents and modes of all files."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mode) for path in files}


def test_everything_that_the_files_tell_is_declared(adapter: Path) -> None:
    """Each value is the adapter's own."""
    found = read(adapter)
    assert found["spec"] == spec.CURRENT
    assert found["name"] == "Grasp"
    assert found["family"] == "vla"
    assert found["paper"] == {
        "title": "Grasping with a Vision-Language-Action Model",
        "url": "https://arxiv.org/abs/2601.00001",
        "arxiv": "2601.00001",
    }
    assert found["upstream"] == {"repository": "https://github.com/somebody/grasp", "revision": None, "license": "MIT"}
    assert found["temporal"] == {"kind": "history", "chunk": 16, "history": 3}
    assert found["control_frequency"] == 25
    assert found["inputs"] == {
        "required": [
            "state.arm_joint_state",
            "state.ee_joint_state",
            "vision.cam_head",
            "vision.cam_left_wrist",
            "vision.cam_right_wrist",
        ],
        "optional": ["instruction"],
    }
    assert found["embodiments"] == ["arx_x5"]
    assert found["action_types"] == ["joint"]
    assert found["evaluation_only"] is False
    assert found["environment"] == {"manager": "conda", "name": "grasp", "python": "3.10"}
    assert found["checkpoints"] == [{"name": "grasp-base", "source": "hf://somebody/grasp-base"}]
    assert found["methods"] == ["set_language"]


def test_the_file_is_valid_and_each_fact_names_its_place(adapter: Path) -> None:
    """Whoever reads the file can look every value up: file, line, and what stands there."""
    done = xpl("adopt", str(adapter), "--json", cwd=adapter.parent)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    answer = json.loads(done.stdout)
    assert answer["open"] == []
    assert validate_yaml_file(adapter / "policy.yml", "policy") == []
    lines = {name: content.split("\n") for name, content in FILES.items()}
    places = [
        place for fact in answer["facts"] for place in fact["evidence"] if place["line"] and place["file"] in lines
    ]
    assert len(places) > 15
    for place in places:
        words = re.findall(r"[A-Za-z_]{4,}", place["what"])
        near = "\n".join(lines[place["file"]][place["line"] - 1 : place["line"] + 1])
        assert any(word in near for word in words), place


def test_nothing_else_is_touched(adapter: Path) -> None:
    """The adapter has one file more, and is otherwise what it was."""
    before = state(adapter)
    assert xpl("adopt", str(adapter), cwd=adapter.parent).returncode == ExitCode.CLEAN
    after = state(adapter)
    assert after.pop("policy.yml")[1] & 0o777 == 0o644
    assert after == before


def test_nothing_of_the_adapter_is_run(adapter: Path) -> None:
    """Code that would leave a trace when it is imported or executed leaves none."""
    trace = adapter.parent / "executed"
    bomb = f"open({str(trace)!r}, 'w').close()\n"
    for name in ("model.py", "deploy.py", "__init__.py"):
        (adapter / name).write_text(bomb + FILES.get(name, ""))
    (adapter / "install.sh").write_text(f"touch {trace}\n")
    assert xpl("adopt", str(adapter), "--scripts", cwd=adapter.parent).returncode == ExitCode.CLEAN
    assert not trace.exists()


def test_dry_run_prints_the_file_and_writes_nothing(adapter: Path) -> None:
    """What is printed is what would be written."""
    before = state(adapter)
    printed = xpl("adopt", str(adapter), "--dry-run", cwd=adapter.parent).stdout
    assert state(adapter) == before
    assert xpl("adopt", str(adapter), cwd=adapter.parent).returncode == ExitCode.CLEAN
    assert printed == (adapter / "policy.yml").read_text()


def test_a_manifest_that_is_there_is_not_replaced(adapter: Path) -> None:
    """It says what to do instead, and the file stays."""
    (adapter / "policy.yml").write_text("name: Mine\n")
    done = xpl("adopt", str(adapter), cwd=adapter.parent)
    assert done.returncode == ExitCode.USAGE
    assert "is there already" in done.stderr
    assert "--merge" in done.stderr
    assert (adapter / "policy.yml").read_text() == "name: Mine\n"


def test_merge_appends_what_is_missing_and_keeps_every_byte(adapter: Path) -> None:
    """Comments, order and values of the author's stay; a second time there is nothing to add."""
    mine = (
        f"# mine\nspec: {spec.CURRENT}\nname: Grasp\nfamily: diffusion # I know better\n"
        "temporal: {kind: chunk, chunk: 3}"
    )
    (adapter / "policy.yml").write_text(mine)
    (adapter / "policy.yml").chmod(0o600)
    done = xpl("adopt", str(adapter), "--merge", "--json", cwd=adapter.parent)
    assert json.loads(done.stdout)["state"] == "completed"
    text = (adapter / "policy.yml").read_text()
    assert text.startswith(mine + "\n")
    assert (adapter / "policy.yml").stat().st_mode & 0o777 == 0o600
    assert yaml.safe_load(text)["temporal"] == {"kind": "chunk", "chunk": 3}
    assert validate_yaml_file(adapter / "policy.yml", "policy") == []
    again = xpl("adopt", str(adapter), "--merge", "--json", cwd=adapter.parent)
    assert json.loads(again.stdout)["state"] == "unchanged"
    assert (adapter / "policy.yml").read_text() == text


def test_missing_scripts_come_only_on_request_and_replace_none(adapter: Path) -> None:
    """Scripts of the author's stay; those of the template may be run."""
    done = xpl("adopt", str(adapter), "--scripts", "--json", cwd=adapter.parent)
    names = set(json.loads(done.stdout)["files"])
    scripts = {*spec.data("package")["scripts"], "install.sh"}
    assert names == {"policy.yml", *scripts} - {"install.sh", "train.sh", "process_data.sh"}
    assert all(os.access(adapter / name, os.X_OK) for name in names - {"policy.yml"})
    assert (adapter / "install.sh").read_text() == FILES["install.sh"]


def test_values_of_the_user_outrank_what_is_read(adapter: Path) -> None:
    """Also where the code says otherwise; and what does not fit is refused before anything is written."""
    done = xpl("adopt", str(adapter), "--set", "temporal.chunk=4", "--set", "family=act", "--json", cwd=adapter.parent)
    assert done.returncode == ExitCode.CLEAN
    found = yaml.safe_load((adapter / "policy.yml").read_text())
    assert (found["temporal"]["chunk"], found["family"]) == (4, "act")
    (adapter / "policy.yml").unlink()
    for setting, told in (
        ("famly=act", "did you mean family"),
        ("family=acts", "did you mean act"),
        ("a.b=1", "no key"),
    ):
        wrong = xpl("adopt", str(adapter), "--set", setting, cwd=adapter.parent)
        assert wrong.returncode == ExitCode.USAGE
        assert told in wrong.stderr
    assert not (adapter / "policy.yml").exists()


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("actions[: self.replan]", "actions", "temporal.chunk"),
        ('self.rate = model_cfg["ctrl_freq"]', "", "control_frequency"),
        ("return resize(", "return (", "cameras.cam_head"),
    ],
)
def test_what_the_code_does_not_tell_stays_open(adapter: Path, old: str, new: str, key: str) -> None:
    """It is asked, marked in the file, and no value is made up."""
    (adapter / "model.py").write_text(MODEL.replace(old, new))
    draft = infer.draft(Source(adapter), {})
    assert key in draft.questions
    line = next(line for line in manifest.text(draft).splitlines() if draft.questions[key].meaning[:20] in line)
    assert spec.data("package")["placeholder"] in line


def test_settings_that_may_help_stand_beside_an_open_chunk(adapter: Path) -> None:
    """A chunk size that nothing cuts by is a hint and no fact: with temporal aggregation it would be wrong."""
    (adapter / "model.py").write_text(MODEL.replace("actions[: self.replan]", "actions"))
    question = infer.draft(Source(adapter), {}).questions["temporal.chunk"]
    assert [str(place) for place in question.seen] == ["deploy.yml:11 replan_steps: 16"]


def test_a_camera_that_black_takes_the_place_of_is_required(adapter: Path) -> None:
    """Else the manifest would take the fault out of the audit."""
    blank = "    return np.zeros((480, 640, 3), dtype=np.uint8)\n"
    stands_in = MODEL.replace(
        "    raise KeyError(names)\n", "    image = vision.get(names[0])\n    if image is None:\n    " + blank
    )
    (adapter / "model.py").write_text(stands_in)
    assert "vision.cam_left_wrist" in read(adapter)["inputs"]["required"]
    (adapter / "model.py").write_text(MODEL.replace("    raise KeyError(names)\n", "    return None\n"))
    assert "vision.cam_left_wrist" in read(adapter)["inputs"]["optional"]


def test_a_branch_that_the_settings_turn_off_reads_nothing(adapter: Path) -> None:
    """The adapter is judged as deploy.yml runs it."""
    packed = "pack_robot_state(obs, self.action_type, None)"
    (adapter / "model.py").write_text(
        MODEL.replace(packed, f"{packed} if self.with_state else None").replace(
            "self.model = None", 'self.model = None\n        self.with_state = model_cfg.get("with_state", True)'
        )
    )
    assert "state.arm_joint_state" in read(adapter)["inputs"]["required"]
    (adapter / "deploy.yml").write_text(DEPLOY + "with_state: false\n")
    assert not any(name.startswith("state.") for names in read(adapter)["inputs"].values() for name in names)


def test_evaluation_only_and_uv(adapter: Path) -> None:
    """Without training scripts the adapter only evaluates; a uv environment lies where install.sh makes it."""
    (adapter / "train.sh").unlink()
    (adapter / "process_data.sh").unlink()
    root = 'ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"\n'
    (adapter / "install.sh").write_text(f'{root}cd "${{ROOT}}/vendored"\nuv venv --python 3.11\nuv pip install -e .\n')
    found = read(adapter)
    assert found["evaluation_only"] is True
    assert found["environment"] == {"manager": "uv", "name": "vendored/.venv", "python": "3.11"}


def test_without_a_model_the_rest_is_still_read(adapter: Path) -> None:
    """A model that does not parse leaves questions and a note."""
    (adapter / "model.py").write_text("class Model(:\n")
    done = xpl("adopt", str(adapter), "--json", cwd=adapter.parent)
    assert done.returncode == ExitCode.CLEAN
    answer = json.loads(done.stdout)
    assert "does not parse" in answer["notes"][0]
    assert {"temporal.chunk", "action_types", "inputs.required"} <= {entry["key"] for entry in answer["open"]}
    assert yaml.safe_load((adapter / "policy.yml").read_text())["embodiments"] == ["arx_x5"]


@pytest.mark.parametrize("gone", sorted(set(FILES) - {"model.py"}))
def test_any_file_may_be_missing(adapter: Path, gone: str) -> None:
    """The model alone makes an adapter; what other files would tell stays open."""
    (adapter / gone).unlink()
    draft = infer.draft(Source(adapter), {})
    manifest.check(manifest.text(draft), draft)
    assert "inputs.required" in draft.facts


def test_a_folder_without_an_adapter_is_not_adopted(tmp_path: Path) -> None:
    """Nor is one that is not there."""
    assert xpl("adopt", str(tmp_path), cwd=tmp_path).returncode == ExitCode.NOT_FOUND
    assert xpl("adopt", "nowhere", cwd=tmp_path).returncode == ExitCode.NOT_FOUND
    assert list(tmp_path.iterdir()) == []


def test_the_printed_audit_is_that_of_the_adopted_adapter(adapter: Path) -> None:
    """Its findings are those of the audit command."""
    said = json.loads(xpl("adopt", str(adapter), "--json", cwd=adapter.parent).stdout)["audit"]
    done = xpl("audit", str(adapter), "--gate", "static", "--json", cwd=adapter.parent)
    results = json.loads(done.stdout)["targets"][0]["gates"][0]["results"]
    failed = [result["code"] for result in results if result["outcome"] in {"fail", "warn"}]
    assert [finding.split()[1] for finding in said["findings"]] == failed
    assert failed


LINES = sorted(
    {line for name in ("model.py", "deploy.yml", "README.md", "install.sh") for line in FILES[name].split("\n")}
)


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(
    name=st.sampled_from(["model.py", "deploy.yml", "README.md", "install.sh"]),
    place=st.integers(0, 60),
    put=st.sampled_from([*LINES, "x: *x", "\t", "    return 9 ** 9 * 'a' * 10 ** 12", '"', "\x00", "[" * 200]),
    drop=st.integers(0, 3),
)
def test_whatever_the_files_hold_the_draft_is_a_manifest_or_a_clear_error(
    tmp_path_factory: pytest.TempPathFactory, name: str, place: int, put: str, drop: int
) -> None:
    """Damaged files leave questions, never a traceback, and what is written parses."""
    folder = written(tmp_path_factory.mktemp("damaged") / "Grasp")
    lines = FILES[name].split("\n")
    at = place % len(lines)
    (folder / name).write_text("\n".join([*lines[:at], put, *lines[at + drop :]]))
    try:
        draft = infer.draft(Source(folder), {})
        text = manifest.text(draft)
        manifest.check(text, draft)
    except UserError as error:
        pytest.fail(str(error))
    assert isinstance(yaml.safe_load(text), dict)


def test_the_page_works_as_shown(adapter: Path) -> None:
    """Its commands run in order; what it shows of the file is what the file says."""
    (example,) = re.findall(r"```console\n(.*?)```", PAGE, flags=re.DOTALL)
    commands = [line.partition("#")[0].split()[1:] for line in example.splitlines()]
    assert len(commands) == 4
    for command in commands:
        done = xpl(*command, cwd=adapter.parent)
        assert done.returncode == ExitCode.CLEAN, (command, done.stderr)
    (shown,) = re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL)
    keys = spec.schema("policy")["properties"]
    assert set(yaml.safe_load(shown)) <= set(keys)
    told = set(re.findall(r"--[a-z][a-z-]+", PAGE))
    options = set(re.findall(r"--[a-z][a-z-]+", xpl("adopt", "--help", cwd=adapter.parent).stdout))
    assert told == options - {"--help", "--output"}
    table = PAGE.partition("Where each fact comes from")[2].partition("## When")[0]
    rows = set(re.findall(r"`([a-z_]+)`", "".join(re.findall(r"^\| `.*?\|", table, flags=re.MULTILINE))))
    written_ = {key.partition(".")[0] for key in infer.draft(Source(adapter), {}).facts}
    assert written_ <= rows <= set(keys)
