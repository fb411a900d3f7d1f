"""The environments of the peers: built whole or not at all, and never a reason to fail."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.client.interop import build


@pytest.fixture
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, value in {"PIP_NO_INDEX": "1", "UV_OFFLINE": "1", "UV_NO_INDEX": "1"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("PIP_FIND_LINKS", raising=False)
    folder = tmp_path / "locks"
    folder.mkdir()
    return folder


@pytest.mark.slow
def test_an_environment_is_built_once_for_each_state_of_its_lock(
    locks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second call does nothing, and a changed lock makes a new environment in place of the old one."""
    where = {"locks": locks, "peers": tmp_path / ".peers"}
    lock = locks / "some.lock.txt"
    lock.write_text("# nothing\n", encoding="utf-8")
    assert build.main(**where) == 0
    python = build.interpreter("some", **where)
    assert python is not None
    made = python.lstat().st_ino
    build.main(**where)
    assert python.lstat().st_ino == made
    lock.write_text("# nothing new\n", encoding="utf-8")
    assert build.interpreter("some", **where) is None
    build.main(**where)
    assert build.interpreter("some", **where) == python
    assert python.lstat().st_ino != made
    assert capsys.readouterr().out == "built .peers/some from some.lock.txt\n" * 2
    assert [entry.name for entry in where["peers"].iterdir()] == ["some"]


@pytest.mark.slow
def test_what_cannot_be_built_is_reported_as_not_run(
    locks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = {"locks": locks, "peers": tmp_path / ".peers"}
    (locks / "broken.lock.txt").write_text("no-such-package==1.0\n", encoding="utf-8")
    (locks / "fine.lock.txt").write_text("", encoding="utf-8")
    assert build.main(**where) == 0
    told = capsys.readouterr().out.splitlines()
    assert len(told) == 2
    assert told[0].startswith("not run: tests with the packages of broken.lock.txt")
    assert told[1].startswith("built")
    assert [entry.name for entry in where["peers"].iterdir()] == ["fine"]


@pytest.mark.slow
def test_an_installer_that_takes_too_long_ends_with_all_that_it_started(tmp_path: Path) -> None:
    """What it started has the only writing end of a pipe, which is at its end once that is gone."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    ours = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with pytest.raises(build.NotBuiltError, match="not done within 1 s"):
        build._run(["sh", "-c", f"sleep 600 > '{pipe}' & wait"], 1.0)
    os.set_blocking(ours, True)
    with os.fdopen(ours) as end:
        assert end.read() == ""
