"""`xpl doctor`: probes that try, tell what they found, and survive what is broken."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.peer import xpl
from xpl_cli.lifecycle.doctor import machine, programs, run
from xpl_cli.lifecycle.doctor.check import MachineCheck, Status

HEAVY = ("numpy", "mujoco", "torch", "copier", "huggingface_hub", "jsonschema", "PIL")


def put(folder: Path, name: str, script: str) -> None:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\n{script}\n")
    (folder / name).chmod(0o755)


@pytest.fixture
def programs_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is all there is on PATH."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder


def test_everything_is_tried_and_what_is_missing_can_be_mended(tmp_path: Path) -> None:
    """One entry for each probe; the exit code follows from what is broken."""
    done = xpl("doctor", "--json", cwd=tmp_path)
    answer = json.loads(done.stdout)
    assert answer["schema"] == "xpl.doctor/1"
    assert [check["name"] for check in answer["checks"]] == list(run._PROBES)
    assert answer["broken"] == [check["name"] for check in answer["checks"] if check["status"] == "broken"]
    assert done.returncode == bool(answer["broken"])
    for check in answer["checks"]:
        assert check["result"].strip()
        assert check["serves"].strip()
        assert check["fix"] or check["status"] == "ok"
    assert list(tmp_path.iterdir()) == []


def test_nothing_heavy_is_imported() -> None:
    """Neither a library of models nor one of graphics is loaded by the tool's own process."""
    code = (
        "import sys; from xpl_cli.lifecycle.doctor import run; run.examine(); "
        f"print(*(set({HEAVY}) & set(sys.modules)))"
    )
    environment = {**os.environ, "PATH": ""}  # fewer programs to wait for
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_people_get_a_line_for_each_and_what_to_do(tmp_path: Path, programs_folder: Path) -> None:
    done = xpl("doctor", cwd=tmp_path)
    lines = done.stdout.splitlines()
    place = next(number for number, line in enumerate(lines) if line.startswith("absent  uv "))
    assert "not on PATH" in lines[place]
    assert "fix: pip install uv" in lines[place + 1]


@pytest.mark.parametrize(
    ("script", "status", "found"),
    [
        (None, Status.ABSENT, "not on PATH"),
        ("echo uv 1.2.3", Status.OK, "uv 1.2.3"),
        ("echo broken >&2; exit 1", Status.BROKEN, "broken"),
        ("kill -SEGV $$", Status.BROKEN, "ended by signal 11"),
    ],
)
def test_a_program_is_asked(programs_folder: Path, script: str | None, status: Status, found: str) -> None:
    if script is not None:
        put(programs_folder, "uv", script)
    check = programs.uv()
    assert (check.status, found in check.result) == (status, True), check


def test_what_does_as_well_is_found(programs_folder: Path) -> None:
    put(programs_folder, "micromamba", "echo 2.0.5")
    put(programs_folder, "podman", "echo podman version 5.1.0")
    assert programs.conda().result == "micromamba 2.0.5"
    assert programs.docker().result == "podman 5.1.0"


@pytest.mark.parametrize(
    ("script", "status", "found"),
    [
        ('[ "$2" = "--format=csv,noheader" ] && echo "NVIDIA H200, 143771 MiB, 570.1"', Status.OK, "NVIDIA H200"),
        ("echo 'NVIDIA-SMI has failed' ; exit 9", None, "nvidia-smi"),
        ("exit 0", None, "lists no card"),
    ],
)
def test_the_driver_is_asked_for_cards(programs_folder: Path, script: str, status: Status | None, found: str) -> None:
    """A driver's tool that is there and does not answer is no card."""
    put(programs_folder, "nvidia-smi", script)
    check = programs.gpu()
    has_device = any(Path("/dev").glob("nvidia[0-9]*"))
    assert check.status is (status or (Status.BROKEN if has_device else Status.ABSENT))
    assert found in check.result


def test_an_interpreter_that_does_not_run_is_none(programs_folder: Path) -> None:
    """Such as the shim of a version that nobody installed."""
    put(programs_folder, "python3.12", "echo 'command not found' >&2; exit 127")
    assert programs.interpreters().status is Status.ABSENT
    (programs_folder / "python3.11").symlink_to(shutil.which("python3", path=os.defpath) or sys.executable)
    (programs_folder / "python3.13").symlink_to(os.path.realpath(sys.executable))
    version = ".".join(map(str, sys.version_info[:3]))
    assert version in programs.interpreters().result


@pytest.mark.parametrize("way", ["egl", "osmesa"])
def test_rendering_is_tried_in_a_process_of_its_own(way: str) -> None:
    """It says what renders, or which library is missing."""
    check = programs.rendering(way)
    assert check.result
    if check.status is Status.ABSENT:
        assert "cannot open shared object" in check.result
        assert (check.fix or "").startswith("apt-get install")


def test_places_that_cannot_be_written_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The place is named; nobody can write there, root included."""
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nothing/there")
    check = machine.disk()
    assert check.status is Status.BROKEN
    assert "cache cannot be written (/proc)" in check.result


@pytest.mark.parametrize("probe", [machine.ports, machine.shared_memory, machine.memory, machine.cores, machine.tool])
def test_this_machine_can_run_its_own_tests(probe: object) -> None:
    """What these tests need themselves works where they run."""
    check = probe()  # type: ignore[operator]
    assert isinstance(check, MachineCheck)
    assert check.status is Status.OK, check


def test_isolation_is_tested_or_the_reason_is_given() -> None:
    """As `--isolate` would."""
    check = machine.isolation()
    assert "tested" in check.result if check.status is Status.OK else "bubblewrap" in check.result


def test_a_probe_that_fails_itself_spoils_no_other() -> None:
    def fail() -> MachineCheck:
        raise ValueError("odd machine")

    check = run._guarded("x", fail)
    assert (check.status, "odd machine" in check.result) == (Status.BROKEN, True)
