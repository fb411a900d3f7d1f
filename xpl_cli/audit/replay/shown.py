"""What a recorded audit showed a policy before it first asked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import images
from xpl_cli.audit.served import recording
from xpl_cli.basics.errors import NotFoundError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_SHOWS = (sdk.Method.UPDATE_OBS, sdk.Method.UPDATE_OBS_BATCH, sdk.Method.INFER)
_MOST = 256


def first_episode(folder: Path) -> list[Mapping[str, Any]]:
    """Return the observations of one environment up to the first question, oldest first.

    Raises:
        NotFoundError: if the folder holds no recording, or none that shows an observation with pictures.
        DamagedError: if it cannot be read.
    """
    for path in recording.find(folder):
        shown: list[Mapping[str, Any]] = []
        for frame in recording.load(path):
            name, given = recording.asked(frame) or ("", None)
            if name in _SHOWS and given is not None:
                one = given[0] if isinstance(given, list) else given
                shown = [*shown, one][-_MOST:]
            elif name == sdk.Method.RESET:
                shown = []
            if shown and name not in _SHOWS[:2] and shown[-1].get(sdk.Obs.VISION):
                return [images.decode_observation(one) for one in shown]
    raise NotFoundError(f"no recording in {folder} shows pictures and asks about them")
