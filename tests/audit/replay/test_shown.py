"""What a recorded audit showed first is found again, for `xpl native show --from`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.adapters import sights
from tests.support.peer import xpl
from xpl import get_embodiment
from xpl.wire import codec
from xpl_cli.audit.replay.shown import first_episode
from xpl_cli.audit.served import recording
from xpl_cli.basics.errors import ExitCode, NotFoundError
from xpl_cli.native import script

if TYPE_CHECKING:
    from pathlib import Path

ABOUT = {
    "created_at": "2026-01-01T00:00:00+00:00",
    "tool": {"name": "xpl", "version": "0"},
    "spec": "v1.1",
    "environment": {},
    "gate": "offline",
    "fingerprint": "0",
    "policy": {"name": "P", "path": "P", "manifest": {}},
    "interpreter": {"python": None, "env": None},
    "overrides": {},
    "config": {},
}
SIZES = {"cam_head": (48, 64), "cam_left_wrist": (48, 64), "cam_right_wrist": (48, 64)}
STAGE = script.Scene(get_embodiment("arx_x5"), SIZES)


def _recorded(folder: Path, *calls: tuple[str, object]) -> Path:
    tape = recording.Tape(folder, ABOUT)
    for name, given in calls:
        kind, payload = recording.request(name, given)
        tape.write(codec.Frame(kind, "1", payload))
    tape.close(complete=True)
    return folder


def test_the_observations_up_to_the_first_question_are_shown(tmp_path: Path) -> None:
    """Of the episode that is asked about: what was shown before a reset is over."""
    one, two, three = (STAGE.observation(0, place) for place in (0, 1, 2))
    calls = [("update_obs", one), ("reset", None), ("update_obs", two), ("update_obs", three), ("get_action", None)]
    found = first_episode(_recorded(tmp_path / "T", *calls, ("update_obs", one)))
    assert [obs["state"]["left_ee_pose"].tolist() for obs in found] == [
        obs["state"]["left_ee_pose"].tolist() for obs in (two, three)
    ]
    folder = sights.made(tmp_path / "P", sights.block())
    done = xpl("native", "show", str(folder), "--from", str(tmp_path / "T"), cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert "the first question of" in (tmp_path / "native-show/index.html").read_text(encoding="utf-8")


def test_a_recording_without_pictures_is_no_scene(tmp_path: Path) -> None:
    """And a folder without a recording is none either."""
    blind = {**STAGE.observation(0, 0), "vision": {}}
    folder = _recorded(tmp_path / "T", ("update_obs", blind), ("get_action", None))
    for place in (folder, tmp_path):
        with pytest.raises(NotFoundError):
            first_episode(place if place == folder else tmp_path / "none")
