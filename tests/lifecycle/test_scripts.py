"""Scripts of a package and the commands behind them, run for real; what docs/lifecycle.md shows works as shown."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.docs.test_audit import blocks, commands
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl.manifest import Manifest
from xpl_cli.basics.errors import ExitCode
from xpl_cli.lifecycle.checkpoints.specification import declared_checkpoints
from xpl_cli.packages import package
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.standard.validate import validate

PAGE = (ROOT / "docs" / "lifecycle.md").read_text(encoding="utf-8")
TELLS = """
import json, os, sys
told = {"prefix": sys.prefix, "folder": os.getcwd(), "gpu": os.environ.get("CUDA_VISIBLE_DEVICES")}
with open("told.json", "w") as file:
    json.dump({**told, "config": json.loads(os.environ["XPL_CONFIG"])}, file)
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh adapter with training scripts in Python, and a program that is `xpl`."""
    folder = tmp_path_factory.mktemp("work shop")
    answers = AdapterAnswers(**{"name": "Foo", **adapter.defaults()})
    adapter.write(adapter.render(answers), folder / "policy" / "Foo")
    for name in ("process_data.py", "train.py"):
        (folder / "policy" / "Foo" / name).write_text(TELLS)
    program = folder / "xpl"
    program.write_text(f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec "{sys.executable}" -m xpl_cli "$@"\n')
    program.chmod(0o755)
    return folder


def script(made: Path, name: str, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a script of the adapter from elsewhere."""
    environment = {**os.environ, "XPL": str(made / "xpl"), **variables}
    return subprocess.run(
        [made / "policy" / "Foo" / name, *arguments],
        cwd=made, env=environment, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip


@contextmanager
def processing(made: Path, text: str, beside: Mapping[str, str]) -> Iterator[Path]:
    """Yield the adapter's folder with another process_data.py in it, and files that are not there else."""
    folder = made / "policy" / "Foo"
    for name, content in {**beside, "process_data.py": text}.items():
        (folder / name).write_text(content)
    try:
        yield folder
    finally:
        (folder / "process_data.py").write_text(TELLS)
        for name in beside:
            (folder / name).unlink()


def told(made: Path) -> dict[str, Any]:
    """Return what a training script was told, and forget it."""
    path = made / "policy" / "Foo" / "told.json"
    answer: dict[str, Any] = json.loads(path.read_text())
    path.unlink()
    return answer


def test_install_says_which_interpreter_it_is(made: Path) -> None:
    """A fresh adapter runs in the tool's own."""
    done = script(made, "install.sh")
    assert (done.returncode, done.stdout.strip()) == (0, sys.executable)


def test_data_processing_gets_its_configuration(made: Path) -> None:
    """In the adapter's folder, with the arguments of the script as settings."""
    done = script(made, "process_data.sh", "my bench", "007", "arx_x5", "ee", "--set", "extra=3")
    assert done.returncode == 0, done.stderr
    answer = told(made)
    assert answer["folder"] == str(made / "policy" / "Foo")
    given = {key: answer["config"][key] for key in ("bench_name", "ckpt_name", "action_type", "extra")}
    assert given == {"bench_name": "my bench", "ckpt_name": "007", "action_type": "ee", "extra": 3}


def test_training_runs_in_the_policys_python_on_its_device(made: Path) -> None:
    """The run name is the one under which the checkpoint is looked for later; a failure has an exit code."""
    own = made / "own"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", own], check=True)
    folder = made / "policy" / "Foo"
    manifest = folder / "policy.yml"
    before = manifest.read_text()
    changed = yaml.safe_load(before)
    changed["environment"] = {"manager": "path", "python": str(own / "bin" / "python")}
    manifest.write_text(yaml.safe_dump(changed))
    try:
        done = script(made, "train.sh", "bench", "demo", "arx_x5", "joint", "0", "3")
        assert done.returncode == 0, done.stderr
        answer = told(made)
        assert (answer["prefix"], answer["gpu"]) == (str(own), "3")
        assert answer["config"]["run_name"] == "bench-demo-arx_x5-joint-0"
        (folder / "train.py").write_text("raise SystemExit(7)")
        failed = script(made, "train.sh", "bench", "demo", "arx_x5", "joint", "0", "3")
        assert (failed.returncode, "failed with exit code 7" in failed.stderr) == (ExitCode.NOT_RUN, True)
    finally:
        manifest.write_text(before)
        (folder / "train.py").write_text(TELLS)


ENDS = {
    "set of another format": ("import deep\ndeep.down('.')\n", "deep.py, line 5: . holds no file that ends in"),
    "own mistake": ("import deep\n\n1 / 0\n", "ZeroDivisionError: division by zero"),
    "no Python": ("import deep\n\n1 +\n", "SyntaxError: invalid syntax"),
}
DEEP = """
from xpl.trajectory import open_folder

def down(folder):
    return open_folder(folder)
"""


@pytest.mark.parametrize("case", ENDS)
def test_what_ends_a_script_is_told_from_the_script_on(case: str, made: Path) -> None:
    """What the standard says is a line, with the place in the package; all else is the traceback that Python prints."""
    text, said = ENDS[case]
    with processing(made, text, beside={"deep.py": DEEP}) as folder:
        done = script(made, "process_data.sh", "bench", "demo", "arx_x5", "joint")
    assert done.returncode == ExitCode.NOT_RUN
    assert said in done.stderr
    if case == "set of another format":
        assert "xpl data convert" in done.stderr
        assert "Traceback" not in done.stderr
    else:
        first = next(line for line in done.stderr.splitlines() if line.startswith("  File "))
        assert first.startswith(f'  File "{folder / "process_data.py"}", line 3')


SPAWNS = """
import json, sys
from multiprocessing import get_context
from pathlib import Path
import neighbour

def twice(number: int) -> int:
    return neighbour.TWO * number

if __name__ == "__main__":
    with get_context("spawn").Pool(1) as pool:
        found = pool.map(twice, [1, 2])
    told = {"found": found, "file": __file__, "arguments": sys.argv, "first": sys.path[0], "own": sorted(globals())}
    told["annotations"] = repr(twice.__annotations__)
    Path("told.json").write_text(json.dumps(told))
"""


def test_a_script_is_what_its_interpreter_would_have_run(made: Path) -> None:
    """Its folder comes first, its processes find its functions, and no name of ours is in it."""
    with processing(made, SPAWNS, beside={"neighbour.py": "TWO = 2\n"}) as folder:
        done = script(made, "process_data.sh", "bench", "demo", "arx_x5", "joint")
        assert done.returncode == 0, done.stderr
        answer = told(made)
        plain = subprocess.run([sys.executable, folder / "process_data.py"], cwd=folder, check=False)
        assert plain.returncode == 0
        assert {**answer, "own": None} == {**told(made), "own": None}
    assert answer["found"] == [2, 4]
    assert not {"functools", "ModuleType", "TracebackType", "main"} & set(answer["own"])


@pytest.mark.slow
def test_evaluation_ends_with_the_line_that_launchers_look_for(made: Path) -> None:
    """A debug run, of a real server in the environment without physics."""
    arguments = ("bench", "any task", "null", "arx_x5", "joint", "0", "0", "0", "-", "-")
    done = script(made, "eval.sh", *arguments, EVAL_ENV_TYPE="debug")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[MAIN] eval finished"


def test_a_policy_for_evaluation_only_is_not_trained(tmp_path: Path) -> None:
    """Declared so, it refuses, whatever files it has; not declared, a missing file is named."""
    folder = tmp_path / "Foo"
    folder.mkdir()
    (folder / "train.py").write_text(TELLS)
    (folder / "policy.yml").write_text("spec: v1\nevaluation_only: true\n")
    for name in ("train", "prepare"):
        done = xpl(name, "Foo", cwd=tmp_path)
        assert (done.returncode, "for evaluation only" in done.stderr) == (ExitCode.USAGE, True)
    assert not (folder / "told.json").exists()
    (folder / "policy.yml").write_text("spec: v1\nevaluation_only: false\n")
    missing = xpl("prepare", "Foo", cwd=tmp_path)
    assert (missing.returncode, "has no process_data.py" in missing.stderr) == (ExitCode.NOT_FOUND, True)


# -- docs/lifecycle.md -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_command_of_the_page_runs(made: Path) -> None:
    """Line by line, with a checkpoint that is a file of this machine."""
    weights = made / "weights.bin"
    weights.write_bytes(b"weights")
    entry = {"name": "base", "source": str(weights), "sha256": hashlib.sha256(b"weights").hexdigest(), "license": "MIT"}
    manifest = made / "policy" / "Foo" / "policy.yml"
    manifest.write_text(f"{manifest.read_text()}\ncheckpoints: [{json.dumps(entry)}]\n")
    found = [one for example in blocks("console", PAGE) for one in commands(example)]
    assert len(found) >= 10
    for one in found:
        done = xpl(*one, cwd=made)
        assert done.returncode in ((0, 1) if one[0] == "doctor" else (0,)), (one, done.stderr)


def test_the_manifests_of_the_page_are_valid(tmp_path: Path) -> None:
    """Each example is a part of policy.yml that its schema and this tool take."""
    for example in blocks("yaml", PAGE):
        part = yaml.safe_load(example)
        (key,) = part
        assert validate(part[key], f"policy#/properties/{key}") == []
        if key == "checkpoints":
            assert list(declared_checkpoints(package.Package(tmp_path, {}, Manifest.parse(part)))) == ["base", "small"]


LOOKS = """
import importlib.util, json, subprocess, sys
look = "import importlib.util as u; print([u.find_spec(n) is not None for n in ('xpl', 'xpl_cli', 'tests')])"
print(subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout)
"""


def test_a_script_finds_the_sdk_in_a_python_that_has_nothing_installed(made: Path, tmp_path: Path) -> None:
    """So do processes that it starts; the tool, and what lies beside the SDK, they do not find."""
    folder = tmp_path / "Foo"
    shutil.copytree(made / "policy" / "Foo", folder)
    (folder / "train.py").write_text(LOOKS)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "bare")], check=True)
    manifest = yaml.safe_load((folder / "policy.yml").read_text())
    manifest["environment"] = {"manager": "path", "python": str(tmp_path / "bare" / "bin" / "python")}
    (folder / "policy.yml").write_text(yaml.safe_dump(manifest))
    done = xpl("train", str(folder), cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert "[True, False, False]" in done.stdout
