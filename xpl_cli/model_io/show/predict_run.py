"""The inputs and the output of an adapter's `predict`, recorded in its own interpreter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import _spec as sdk
from xpl.nested import format_path, leaves
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.isolation import subprocess_task
from xpl_cli.lifecycle import interpreter
from xpl_cli.model_io.show import image_transforms
from xpl_cli.model_io.show.views import ImageView

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Config, Observation
    from xpl_cli.packages.package import Package

_ERRAND: Final = "xpl.worker.model_inputs"
_LEAST_SIDE: Final = 16
"""Of what is taken for a picture, pixels."""
_MOST_PICTURES: Final = 32
_FRAME: Final = 2.0
"""Largest difference, of 255, within a frame of one colour."""


@dataclass(frozen=True)
class RunOptions:
    """How the adapter is run; as for `xpl serve`."""

    python: str | None = None
    env: str | None = None
    patience: float = 300.0


@dataclass(frozen=True)
class PredictCall:
    """One call of `predict`.

    Attributes:
        inputs: what `predict` got.
        raw: what it answered of the one environment.
        steps: what became of that.
        failed: why nothing did, "" if all is well.
    """

    inputs: Any
    raw: Any
    steps: list[dict[str, np.ndarray]]
    failure: str = ""


def run_predict(
    package: Package, config: Config, observations: Sequence[Observation], options: RunOptions
) -> PredictCall:
    """Run an adapter on the observations of an episode, and return inputs and output of the last `predict`.

    Raises:
        UserError: if the adapter cannot be loaded, does not answer, or has no `predict`.
    """
    request = {
        "policy_dir": str(package.path),
        "config": dict(config),
        "manifest": dict(package.manifest.data),
        "observations": [dict(one) for one in observations],
    }
    python = interpreter.resolve(package.path, package.manifest.environment, python=options.python, env=options.env)
    task_result = subprocess_task.run(
        _ERRAND, request, subprocess_task.TaskSettings(python, package.path, patience=options.patience)
    )
    for answer in task_result.answers:
        if answer.error is not None:
            raise UserError(f"{package.path}: {answer.error}", code=ExitCode.NOT_RUN)
    if task_result.problem is not None or len(task_result.answers) < len(("load", "question")):
        raise UserError(f"{package.path}: its process {task_result.failure}", code=ExitCode.NOT_RUN)
    result = task_result.answers[1].result
    if "inputs" not in result:
        raise UserError(f"{package.path} answers without calling predict", code=ExitCode.NOT_RUN)
    raw = result.get("raw")
    one = raw[0] if isinstance(raw, (list, np.ndarray)) and len(raw) else raw
    return PredictCall(result["inputs"], one, result["steps"], result.get("failed", ""))


def unbatched(inputs: Any) -> dict[str, Any]:
    """Return the inputs of the only environment of a batch, by name."""
    if isinstance(inputs, dict):
        return {
            name: value[0] for name, value in inputs.items() if isinstance(value, (list, np.ndarray)) and len(value)
        }
    first = inputs[0] if isinstance(inputs, list) and inputs else inputs
    return {str(name): value for name, value in first.items()} if isinstance(first, dict) else {"inputs": first}


def describe_inputs(inputs: Any) -> list[str]:
    """Return every array and text among inputs that nothing describes, in words."""
    return [
        f"{name}: {value!r}"
        if isinstance(value, (str, int, float))
        else f"{name}: {value.shape} {value.dtype}, {_range(value)}"
        for name, value in _values(inputs)
    ]


def find_images(inputs: Any, observation: Observation) -> list[ImageView]:
    """Return what among inputs looks like a picture, beside the camera's that it is most like."""
    taken = {
        name: np.asarray(entry[sdk.Camera.COLOR])
        for name, entry in (observation.get(sdk.Obs.VISION) or {}).items()
        if sdk.Camera.COLOR in entry
    }
    views: list[ImageView] = []
    for name, value in _values(inputs):
        for index, values in enumerate(_planes(value)) if isinstance(value, np.ndarray) else ():
            if len(views) == _MOST_PICTURES or not taken:
                return views
            views.append(_guess_view(name, index, values, value, taken))
    return views


def _guess_view(
    name: str, index: int, values: np.ndarray, value: np.ndarray, taken: Mapping[str, np.ndarray]
) -> ImageView:
    view = ImageView(name, index, "", 0, values, values, values, value.shape, str(value.dtype), (), ())
    inside = _unframed(view.raw)
    camera, words = min(
        ((one, image_transforms.nearest_transform(inside, picture)) for one, picture in taken.items()),
        key=lambda pair: pair[1][1],
    )
    notes = [f"most like {camera}", *words[0]]
    return ImageView(
        name,
        index,
        camera,
        0,
        taken[camera],
        values,
        view.raw,
        value.shape,
        str(value.dtype),
        (_range(values),),
        tuple(notes),
    )


def _values(inputs: Any) -> Iterator[tuple[str, Any]]:
    """Yield every value among inputs with its place."""
    yield from ((format_path(path), value) for path, value in leaves(unbatched(inputs)) if value is not None)


def _planes(value: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the pictures of an array: (..., h, w, 3) or (..., 3, h, w), as (h, w, 3)."""
    if value.ndim < 3 or value.dtype.kind not in "uif":
        return
    if value.shape[-1] == 3 and min(value.shape[-3:-1]) >= _LEAST_SIDE:
        yield from value.reshape(-1, *value.shape[-3:])
    elif value.shape[-3] == 3 and min(value.shape[-2:]) >= _LEAST_SIDE:
        yield from np.moveaxis(value.reshape(-1, *value.shape[-3:]), 1, -1)


def _unframed(picture: np.ndarray) -> np.ndarray:
    """Return a picture without a frame of one colour, as a letterbox has it."""
    corner = picture[0, 0].astype(np.float32)
    inside = np.abs(picture.astype(np.float32) - corner).max(-1) > _FRAME
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    if not len(rows):
        return picture
    return picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _range(values: np.ndarray) -> str:
    if values.dtype.kind not in "uif" or not values.size:
        return "no numbers"
    return f"{float(values.min()):.4g} to {float(values.max()):.4g}"
