"""The curves of an episode: what a trace holds, as panels that the page draws."""

from __future__ import annotations

import base64
import zipfile
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np

Curves = dict[str, Any]
"""What `read` returns."""
STATE = "state"
MOST_POINTS = 600
"""Points of a curve; of a longer one every n-th is drawn."""

_MOST = 65535
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_TITLES = {
    sdk.State.ARM_JOINT_STATE: "arm joint",
    sdk.State.EE_JOINT_STATE: "gripper",
    sdk.State.EE_POSE: "flange",
    sdk.State.TCP_POSE: "fingertips",
}


def read(path: Path) -> Curves:
    """Return the curves of a trace, ready for JSON.

    Returns:
        `frequency` in Hz, `chunks` (control steps at which a chunk begins), `at` (control steps of the points of the
        curves `state` and `action`), and `panels`: each with a `title`, `low`, `high`, and the curves that there are,
        as base64 of little-endian uint16 from `low` to `high`.

    Raises:
        UserError: if the file is no trace.
    """
    import numpy as np

    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        frequency = float(arrays.pop(sdk.Obs.FREQUENCY))
        chunks = arrays.pop("chunk_starts").tolist()
        steps = {STATE: arrays.pop("state_steps")}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise UserError(f"{path} holds no curves: {error}", code=ExitCode.NOT_RUN) from None
    columns: dict[str, dict[int, dict[str, np.ndarray]]] = {}
    for key, values in sorted(arrays.items()):
        source, _, name = key.partition(".")
        steps.setdefault(source, np.arange(len(values)))
        for place, column in enumerate(values.T):
            columns.setdefault(name, {}).setdefault(place, {})[source] = _thin(column)
    return {
        sdk.Obs.FREQUENCY: frequency,
        "chunks": chunks,
        "at": {source: _thin(at).tolist() for source, at in steps.items()},
        "panels": [
            {"title": _title(name, place, len(places)), **_levels(sources)}
            for name, places in columns.items()
            for place, sources in places.items()
        ],
    }


def _thin(values: np.ndarray) -> np.ndarray:
    """Return at most `MOST_POINTS` of the values, equally spaced."""
    return values[:: max(1, -(-len(values) // MOST_POINTS))]


def _levels(sources: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return curves with one scale for all."""
    import numpy as np

    values = np.concatenate(list(sources.values())).astype(np.float64)
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    scale = _MOST / (high - low) if high > low else 0.0
    drawn = {}
    for source, column in sources.items():
        levels = np.nan_to_num((column.astype(np.float64) - low) * scale).clip(0, _MOST).astype("<u2")
        drawn[source] = base64.b64encode(levels.tobytes()).decode()
    return {"low": low, "high": high, **drawn}


def _title(name: str, place: int, count: int) -> str:
    """Return the title of a column: ``left_arm_joint_state``, 2 -> ``left arm joint 3``."""
    for ending, words in _TITLES.items():
        if name.endswith(ending):
            side = name.removesuffix(ending).rstrip("_")
            number = "" if count == 1 else f" {_POSE[place] if count == len(_POSE) and 'pose' in ending else place + 1}"
            return f"{side} {words}{number}".strip()
    return f"{name.replace('_', ' ')} {place + 1}" if count > 1 else name.replace("_", " ")
