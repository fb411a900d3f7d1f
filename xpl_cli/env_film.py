"""A picture of an environment, and a film of its expert."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import images
from xpl_cli import atomic, env_play, environments
from xpl_cli.errors import UserError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from xpl_cli.env_play import Scenario

FORMATS = (".webp", ".gif", ".png")
"""Endings of a film; each format can be animated."""

_EVERY = 2  # control steps to a frame: enough for the eye


def render(what: Scenario, seed: int, camera: str | None, out: Path) -> None:
    """Write what a camera sees when an episode begins.

    Raises:
        UserError: no such scenario or camera, or another ending than .png.
    """
    _check_ending(out, (".png",))
    with contextlib.closing(env_play.make(what)) as env:
        env.reset([seed])
        atomic.write_file(out, images.encode_png(_look(env, camera)))


def film(what: Scenario, seed: int, camera: str | None, out: Path) -> dict[str, Any]:
    """Write a film of the expert and return the episode's result.

    Raises:
        UserError: no such scenario or camera, or an ending that is not in FORMATS.
    """
    import io

    from PIL import Image

    _check_ending(out, FORMATS)
    frames: list[Any] = []
    step = 0
    with contextlib.closing(env_play.make(what)) as env:

        def watch() -> None:
            nonlocal step
            if step % _EVERY == 0:
                frames.append(Image.fromarray(_look(env, camera)))
            step += 1

        result = env_play.play(env, env_play.expert(what), seed, watch)
    frequency = environments.manifest(environments.find(what.environment))["control_frequency"]
    buffer = io.BytesIO()
    pace = round(1000 * _EVERY / frequency)
    frames[0].save(buffer, _format(out), save_all=True, append_images=frames[1:], duration=pace, loop=0)
    atomic.write_file(out, buffer.getvalue())
    return result


def _look(env: Any, camera: str | None) -> np.ndarray:
    try:
        seen: np.ndarray = env.render(0, camera or sdk.OPTIONAL_CAMERAS[0])
    except ValueError as error:
        raise UserError(str(error)) from None
    return seen


def _format(out: Path) -> str:
    return out.suffix.lower().lstrip(".")


def _check_ending(out: Path, known: tuple[str, ...]) -> None:
    if out.suffix.lower() not in known:
        raise UserError(f"{out}: the name must end in {' or '.join(known)}")
    if not out.resolve().parent.is_dir():
        raise UserError(f"{out}: its folder does not exist")
