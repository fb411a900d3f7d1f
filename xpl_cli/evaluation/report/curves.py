"""The curves of an episode: what a trace holds, as panels that the page draws."""

from __future__ import annotations

import base64
import io
import math
import zipfile
import zlib
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.sizes import format_size

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

Curves = dict[str, Any]
"""What `read` returns."""
STATE = "state"
MOST_POINTS = 600
"""Points of a curve; of a longer one every n-th is drawn."""

_MOST_BYTES, _MOST_COLUMNS = 32 << 20, 2000
"""What no trace comes near: one of 10,000 steps with 100 columns has 4 MB."""
_STEPS = ("chunk_starts", "state_steps")
_MOST = 65535
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_TITLES = {
    sdk.State.ARM_JOINT_STATE: "arm joint",
    sdk.State.EE_JOINT_STATE: "gripper",
    sdk.State.EE_POSE: "flange",
    sdk.State.TCP_POSE: "fingertips",
}


def read(content: bytes, name: str) -> Curves:
    """Return the curves of a trace, ready for JSON.

    Args:
        content: of the .npz.
        name: of the file, for sentences.

    Returns:
        `frequency` in Hz, `chunks` (control steps at which a chunk begins), `at` (control steps of the points of the
        curves `state` and `action`), and `panels`: each with a `title`, `low`, `high`, and the curves that there are,
        as base64 of little-endian uint16 from `low` to `high`.

    Raises:
        UserError: if the file is no trace.
    """
    import numpy as np

    try:
        arrays = _arrays(content)
        frequency = float(arrays.pop(sdk.Obs.FREQUENCY))
        chunks, steps = arrays.pop(_STEPS[0]).tolist(), {STATE: arrays.pop(_STEPS[1])}
    except KeyError as error:
        raise UserError(f"{name} holds no curves: it has no array {error}", code=ExitCode.NOT_RUN) from None
    except (OSError, ValueError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise UserError(f"{name} holds no curves: {error}", code=ExitCode.NOT_RUN) from None
    columns: dict[str, dict[int, dict[str, np.ndarray]]] = {}
    for key, values in sorted(arrays.items()):
        source, _, curve = key.partition(".")
        steps.setdefault(source, np.arange(len(values)))
        for index, column in enumerate(values.T):
            columns.setdefault(curve, {}).setdefault(index, {})[source] = _thin(column)
    return {
        sdk.Obs.FREQUENCY: frequency,
        "chunks": chunks,
        "at": {source: _thin(at).tolist() for source, at in steps.items()},
        "panels": [
            {"title": _title(curve, index, len(columns_of_curve)), **_levels(sources)}
            for curve, columns_of_curve in columns.items()
            for index, sources in columns_of_curve.items()
        ],
    }


def _arrays(content: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz, of the kinds and within the bounds of a trace.

    Raises:
        ValueError, zipfile.BadZipFile and what else damaged bytes lead to: it is none.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as stored:
        total = sum(entry.file_size for entry in stored.infolist())
        if total > _MOST_BYTES:
            raise ValueError(f"it would unpack to {format_size(total)}, more than {format_size(_MOST_BYTES)}")
        arrays = {name.removesuffix(".npy"): _array(stored.read(name), name) for name in stored.namelist()}
    for name, values in arrays.items():
        depth = 0 if name == sdk.Obs.FREQUENCY else 1 if name in _STEPS else 2
        if values.ndim != depth or values.dtype.kind not in ("iu" if name in _STEPS else "iuf"):
            raise ValueError(f"{name!r:.80}: expected numbers in {depth} dimensions, got {values.dtype} {values.shape}")
    if sum(values.shape[1] for values in arrays.values() if values.ndim > 1) > _MOST_COLUMNS:
        raise ValueError(f"it has more than {_MOST_COLUMNS} curves")
    frequency = arrays.get(sdk.Obs.FREQUENCY)
    if frequency is not None and not math.isfinite(frequency):
        raise ValueError(f"{sdk.Obs.FREQUENCY}: expected a finite number, got {frequency}")
    return arrays


def _array(content: bytes, name: str) -> np.ndarray:
    """Return the array of a .npy; its header is checked against its size before memory is allocated."""
    import numpy as np
    from numpy.lib import format as npy

    stream = io.BytesIO(content)
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    version = npy.read_magic(stream)
    if version not in readers:
        raise ValueError(f"{name!r:.80} is of version {version}")
    shape, is_fortran, dtype = readers[version](stream)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(content) - stream.tell():
        raise ValueError(f"{name!r:.80}: its header says {dtype} {shape!s:.80}, its content differs")
    return np.frombuffer(content, dtype, offset=stream.tell()).reshape(shape, order="F" if is_fortran else "C")


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
        with np.errstate(over="ignore", invalid="ignore"):  # a range beyond all floats is drawn as a line
            levels = np.nan_to_num((column.astype(np.float64) - low) * scale).clip(0, _MOST).astype("<u2")
        drawn[source] = base64.b64encode(levels.tobytes()).decode()
    return {"low": low, "high": high, **drawn}


def _title(name: str, index: int, count: int) -> str:
    """Return the title of a column: ``left_arm_joint_state``, 2 -> ``left arm joint 3``."""
    for ending, words in _TITLES.items():
        if name.endswith(ending):
            side = name.removesuffix(ending).rstrip("_")
            number = "" if count == 1 else f" {_POSE[index] if count == len(_POSE) and 'pose' in ending else index + 1}"
            return f"{side} {words}{number}".strip()
    return f"{name.replace('_', ' ')} {index + 1}" if count > 1 else name.replace("_", " ")
