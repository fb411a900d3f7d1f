"""`xpl adopt`: what an adapter's files state, what stays unknown, and what is never touched."""

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

from tests.support.adapters.adopted import DEPLOY, FILES, written
from tests.support.checkout import ROOT
from tests.support.commands import xpl
from tests.support.examples import examples
from xpl_cli.adopt import package
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.packages import package as packages
from xpl_cli.standard import spec
from xpl_cli.standard.validate import validate_yaml_file

PAGE = (ROOT / "docs" / "adopt.md").read_text(encoding="utf-8")
UNKNOWN = ("family", "temporal", "control_frequency", "inputs", "cameras", "gripper")
"""Required parts of a manifest that no file of the adapter of these tests states."""


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    return written(tmp_path / "Grasp")


def read(folder: Path, **given_: Any) -> dict[str, Any]:
    """Return the manifest that adoption would write, as a map."""
    chosen = package.adoption(folder, given_, merge=False, scripts=False)
    document: dict[str, Any] = yaml.safe_load(chosen.files["policy.yml"])
    return document


def state(folder: Path) -> dict[str, tuple[bytes, int]]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mode) for path in files}


def test_everything_that_the_files_state_is_declared(adapter: Path) -> None:
    manifest = read(adapter)
    assert manifest["spec"] == spec.VERSION
    assert manifest["name"] == "Grasp"
    assert manifest["embodiments"] == ["arx_x5"]
    assert manifest["action_types"] == ["joint"]
    assert manifest["evaluation_only"] is False
    assert manifest["environment"]["manager"] == "conda"
    assert manifest["environment"]["python"] == "3.10"
    assert manifest["methods"] == ["set_language"]


def test_what_deploy_yml_says_comes_before_what_documents_show(adapter: Path) -> None:
    (adapter / "deploy.yml").write_text(
        DEPLOY.replace("env_cfg_type: null", "env_cfg_type: franka_single").replace(
            "action_type: null", "action_type: ee"
        )
    )
    manifest = read(adapter)
    assert (manifest["embodiments"], manifest["action_types"]) == (["franka_single"], ["ee"])


@pytest.mark.parametrize(
    ("script", "wanted"),
    [
        ("conda create -n grasp python=3.11 -y\n", {"manager": "conda", "name": "grasp", "python": "3.11"}),
        ("# conda create -n old\nconda activate grasp\n", {"manager": "conda", "name": "grasp"}),
        ('conda create -n "${NAME}" python=3.10\n', {"manager": "conda", "name": None, "python": "3.10"}),
        ("uv venv --python 3.11\n", {"manager": "uv", "python": "3.11"}),
        ('cd "${ROOT}/vendored"\nuv sync\n', {"manager": "uv", "name": None}),
        ("python3 -m venv .venv\n", {"manager": "venv"}),
    ],
)
def test_the_interpreter_is_the_one_that_a_script_makes(adapter: Path, script: str, wanted: dict[str, Any]) -> None:
    (adapter / "install.sh").write_text(script)
    found = read(adapter)["environment"]
    assert {key: None if isinstance(value, dict) else value for key, value in found.items()} == wanted


def test_nothing_is_concluded_from_code(adapter: Path) -> None:
    manifest = read(adapter)
    for key in UNKNOWN:
        value = manifest[key]
        entries = [value] if set(value) == {"unknown"} else list(value.values())
        assert all(set(entry) == {"unknown"} and entry["unknown"] for entry in entries), key


def test_each_value_names_its_place(adapter: Path) -> None:
    completed = xpl("adopt", str(adapter), "--json", folder=adapter.parent)
    assert completed.code == ExitCode.CLEAN, completed.stderr
    answer = json.loads(completed.stdout)
    keys = {entry["key"].partition(".")[0] for entry in answer["unknown"]}
    assert keys == {*UNKNOWN, "environment"}
    lines = {name: content.split("\n") for name, content in FILES.items()}
    sources = [source for fact in answer["facts"] for source in fact["evidence"] if source["line"]]
    assert len(sources) == 3
    for source in sources:
        near = lines[source["file"]][source["line"] - 1]
        assert any(word in near for word in re.findall(r"[A-Za-z_]{4,}", source["what"])), source


def test_what_is_unknown_keeps_nobody_from_running_the_adapter(adapter: Path) -> None:
    assert xpl("adopt", str(adapter), folder=adapter.parent).code == ExitCode.CLEAN
    loaded = packages.load(adapter)
    assert loaded.config()["env_cfg_type"] == "arx_x5"
    assert not set(UNKNOWN) & set(loaded.manifest.data)
    problems = validate_yaml_file(adapter / "policy.yml", "policy")
    assert {str(problem.path[0]) for problem in problems} == set(UNKNOWN)
    assert all(problem.message.startswith("unknown: ") and problem.line for problem in problems)
    (chunk,) = (problem for problem in problems if problem.path == ("temporal", "chunk"))
    text = (adapter / "policy.yml").read_text().splitlines()
    assert "chunk" in text[(chunk.line or 1) - 1]


def test_nothing_of_the_adapter_is_run(adapter: Path) -> None:
    trace = adapter.parent / "executed"
    bomb = f"open({str(trace)!r}, 'w').close()\n"
    for name in ("model.py", "deploy.py", "__init__.py"):
        (adapter / name).write_text(bomb + FILES.get(name, ""))
    (adapter / "install.sh").write_text(f"touch {trace}\n")
    assert xpl("adopt", str(adapter), "--scripts", folder=adapter.parent).code == ExitCode.CLEAN
    assert not trace.exists()


def test_only_the_manifest_is_written_and_a_dry_run_prints_it(adapter: Path) -> None:
    before = state(adapter)
    printed = xpl("adopt", str(adapter), "--dry-run", folder=adapter.parent).stdout
    assert state(adapter) == before
    assert xpl("adopt", str(adapter), folder=adapter.parent).code == ExitCode.CLEAN
    after = state(adapter)
    assert after.pop("policy.yml") == (printed.encode(), 0o100644)
    assert after == before, "something else was touched"


def test_a_manifest_that_is_there_is_not_replaced(adapter: Path) -> None:
    (adapter / "policy.yml").write_text("name: Mine\n")
    completed = xpl("adopt", str(adapter), folder=adapter.parent)
    assert completed.code == ExitCode.USAGE
    assert "exists already" in completed.stderr
    assert "--merge" in completed.stderr
    assert (adapter / "policy.yml").read_text() == "name: Mine\n"


def test_merge_appends_what_is_missing_and_keeps_every_byte(adapter: Path) -> None:
    mine = (
        f"# mine\nspec: {spec.VERSION}\nname: Grasp\nfamily: diffusion # I know better\n"
        "temporal: {kind: chunk, chunk: 3}"
    )
    (adapter / "policy.yml").write_text(mine)
    (adapter / "policy.yml").chmod(0o600)
    completed = xpl("adopt", str(adapter), "--merge", "--json", folder=adapter.parent)
    assert json.loads(completed.stdout)["state"] == "completed"
    text = (adapter / "policy.yml").read_text()
    assert text.startswith(mine + "\n")
    assert (adapter / "policy.yml").stat().st_mode & 0o777 == 0o600
    manifest = yaml.safe_load(text)
    assert manifest["temporal"] == {"kind": "chunk", "chunk": 3}
    assert manifest["embodiments"] == ["arx_x5"]
    again = xpl("adopt", str(adapter), "--merge", "--json", folder=adapter.parent)
    assert json.loads(again.stdout)["state"] == "unchanged"
    assert (adapter / "policy.yml").read_text() == text


def test_missing_scripts_come_only_on_request_and_replace_none(adapter: Path) -> None:
    completed = xpl("adopt", str(adapter), "--scripts", "--json", folder=adapter.parent)
    names = set(json.loads(completed.stdout)["files"])
    scripts = {*spec.data("package")["scripts"], "install.sh"}
    assert names == {"policy.yml", *scripts} - {"install.sh", "train.sh", "process_data.sh"}
    assert all(os.access(adapter / name, os.X_OK) for name in names - {"policy.yml"})
    assert (adapter / "install.sh").read_text() == FILES["install.sh"]


def test_values_of_the_user_outrank_what_is_read(adapter: Path) -> None:
    completed = xpl(
        "adopt",
        str(adapter),
        "--set",
        "temporal.chunk=4",
        "--set",
        "embodiments=[piper]",
        "--json",
        folder=adapter.parent,
    )
    assert completed.code == ExitCode.CLEAN
    manifest = yaml.safe_load((adapter / "policy.yml").read_text())
    assert (manifest["temporal"]["chunk"], manifest["embodiments"]) == (4, ["piper"])
    assert set(manifest["temporal"]["kind"]) == {"unknown"}
    (adapter / "policy.yml").unlink()
    for setting, told in (
        ("famly=act", "did you mean family"),
        ("family=acts", "did you mean act"),
        ("a.b=1", "no key"),
    ):
        wrong = xpl("adopt", str(adapter), "--set", setting, folder=adapter.parent)
        assert wrong.code == ExitCode.USAGE
        assert told in wrong.stderr
    assert not (adapter / "policy.yml").exists()


def test_a_policy_without_training_scripts_only_evaluates(adapter: Path) -> None:
    (adapter / "train.sh").unlink()
    assert read(adapter)["evaluation_only"] is False
    (adapter / "process_data.sh").unlink()
    assert read(adapter)["evaluation_only"] is True


@pytest.mark.parametrize("gone", sorted(set(FILES) - {"model.py"}))
def test_any_file_may_be_missing(adapter: Path, gone: str) -> None:
    (adapter / gone).unlink()
    assert read(adapter)["name"] == "Grasp"


def test_a_folder_without_an_adapter_is_not_adopted(tmp_path: Path) -> None:
    assert xpl("adopt", str(tmp_path), folder=tmp_path).code == ExitCode.NOT_FOUND
    assert xpl("adopt", "nowhere", folder=tmp_path).code == ExitCode.NOT_FOUND
    assert list(tmp_path.iterdir()) == []


def test_the_printed_audit_is_that_of_the_adopted_adapter(adapter: Path) -> None:
    said = json.loads(xpl("adopt", str(adapter), "--json", folder=adapter.parent).stdout)["audit"]
    completed = xpl("audit", str(adapter), "--gate", "static", "--json", folder=adapter.parent)
    results = json.loads(completed.stdout)["targets"][0]["gates"][0]["results"]
    failed = [result["code"] for result in results if result["outcome"] in {"fail", "warn"}]
    assert [finding.split()[1] for finding in said["findings"]] == failed
    assert failed


READ = ("deploy.py", "deploy.yml", "README.md", "install.sh")
LINES = sorted({line for name in READ for line in FILES[name].split("\n")})


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(
    name=st.sampled_from(READ),
    place=st.integers(0, 60),
    put=st.sampled_from([*LINES, "x: *x", "\t", 'env_cfg_type: "arx_x5', '"', "\x00", "[" * 200]),
    drop=st.integers(0, 3),
)
def test_whatever_the_files_hold_the_draft_is_a_manifest_or_a_clear_error(
    tmp_path_factory: pytest.TempPathFactory, name: str, place: int, put: str, drop: int
) -> None:
    folder = written(tmp_path_factory.mktemp("damaged") / "Grasp")
    lines = FILES[name].split("\n")
    at = place % len(lines)
    (folder / name).write_text("\n".join([*lines[:at], put, *lines[at + drop :]]))
    try:
        assert read(folder)["name"] == "Grasp"
    except UserError as error:
        pytest.fail(str(error))


def test_the_page_works_as_shown(adapter: Path) -> None:
    (example,) = re.findall(r"```console\n(.*?)```", PAGE, flags=re.DOTALL)
    commands = [line.partition("#")[0].split()[1:] for line in example.splitlines()]
    assert len(commands) == 4
    for command in commands:
        completed = xpl(*command, folder=adapter.parent)
        assert completed.code == ExitCode.CLEAN, (command, completed.stderr)
    (shown,) = re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL)
    assert yaml.safe_load(shown).items() <= read_again(adapter).items()


def read_again(folder: Path) -> dict[str, Any]:
    """Return the manifest that would be written if there were none."""
    (folder / "policy.yml").unlink()
    return read(folder)
