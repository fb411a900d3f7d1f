"""A picture of an environment, and a film of its expert."""

from __future__ import annotations

import contextlib
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import get_embodiment, image_codec
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.environments import rollout
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import numpy as np

    from xpl_cli.environments.rollout import Scenario

FORMATS = (".webp", ".gif", ".png")
"""Endings of a film; each format can be animated."""

_EVERY = 2  # control steps to a frame: enough for the eye


def render(scenario: Scenario, seed: int, camera: str | None, out: Path) -> dict[str, Any]:
    """Save an image of a camera at the beginning of an episode; return its description.

    Raises:
        NotFoundError: there is no such camera.
        UserError: the scenario is not offered, the renderer is missing, or the file does not end in .png.
    """
    check_ending(out, (".png",))
    camera = camera_of(scenario, camera)
    ((frame, wording),) = first_frames(scenario, [scenario.task], seed, camera)
    atomic.write_file(out, image_codec.encode_png(frame))
    height, width = frame.shape[:2]
    size = {"height": height, "width": width}
    return {**describe_picture(scenario, seed, camera, out), **size, sdk.Obs.INSTRUCTION: wording}


def first_frames(scenario: Scenario, tasks: Sequence[str], seed: int, camera: str) -> Iterator[tuple[np.ndarray, str]]:
    """Yield a camera's image (H, W, 3) uint8 at the beginning of an episode of each task, and its instruction.

    One environment runs all of them: if it has a process of its own, that is started once.
    """
    with contextlib.closing(rollout.make(replace(scenario, task=tasks[0]))) as env, _renderer_errors(scenario):
        for task in tasks:
            env.reset([seed], {"task": task})
            yield _render_frame(env, camera), env.get_obs()[sdk.Obs.INSTRUCTION]


def film(scenario: Scenario, player: str, seed: int, camera: str | None, out: Path) -> dict[str, Any]:
    """Save a video of an episode; return its description, with the `episode`'s result.

    Args:
        scenario: the scenario.
        player: one of `rollout.PLAYERS`.
        seed: of the episode.
        camera: name; the overview camera by default.
        out: file with one of the endings in `FORMATS`.

    Raises:
        NotFoundError: there is no such camera or player.
        UserError: the scenario is not offered, the renderer is missing, or another ending.
    """
    check_ending(out, FORMATS)
    camera = camera_of(scenario, camera)
    scenario, act = rollout.make_player(player, scenario, seed)
    facts = environments.manifest(environments.find(scenario.environment))
    with contextlib.closing(rollout.make(scenario)) as env, _renderer_errors(scenario):
        reel = FilmRecorder(facts.frequency(scenario.task), camera)
        result = rollout.run_episode(env, act, seed, lambda: reel.add_frame(env))
    reel.save(out)
    return {**describe_picture(scenario, seed, camera, out), "player": player, "episode": result}


class FilmRecorder:
    """Records a video of one environment.

    Args:
        frequency: control rate, Hz.
        camera: name; the overview camera by default.

    Attributes:
        steps: number of recorded control steps.
    """

    def __init__(self, frequency: float, camera: str | None = None) -> None:
        self._pace = round(1000 * _EVERY / frequency)
        self._camera = camera
        self._frames: list[Any] = []
        self.steps = 0

    def add_frame(self, env: Any, env_idx: int = 0) -> None:
        """Add a frame; to be called once for every control step.

        Raises:
            UserError: there is no such camera.
        """
        from PIL import Image

        if self.steps % _EVERY == 0:
            self._frames.append(Image.fromarray(_render_frame(env, self._camera, env_idx)))
        self.steps += 1

    def save(self, out: Path) -> None:
        """Write the film; nothing where nothing was seen.

        Args:
            out: file, whose ending is one of `FORMATS`.
        """
        content = self.encode(_format(out))
        if content is not None:
            atomic.write_file(out, content)

    def encode(self, kind: str = FORMATS[0].lstrip(".")) -> bytes | None:
        """Return the film as the content of a file, None where nothing was seen."""
        import io

        if not self._frames:
            return None
        buffer = io.BytesIO()
        first, *others = self._frames
        first.save(buffer, kind, save_all=True, append_images=others, duration=self._pace, loop=0)
        return buffer.getvalue()


def describe_picture(scenario: Scenario, seed: int, camera: str, out: Path) -> dict[str, Any]:
    """Return the description of an image or video, and its path."""
    return {"file": str(out), **asdict(scenario), sdk.Deploy.SEED: seed, "camera": camera}


def camera_of(scenario: Scenario, requested: str | None) -> str:
    """Return the name of a camera: the one for people, or the first, where none is wanted."""
    mine, others = sdk.CAMERAS[len(get_embodiment(scenario.embodiment).arms)], set().union(*sdk.CAMERAS.values())
    entries = environments.manifest(environments.find(scenario.environment)).cameras
    names = [name for name in entries if name in mine or name not in others]
    usual = next((name for name in sdk.OPTIONAL_CAMERAS if name in names), None)
    return rollout.choose_name("camera", requested or usual, names)


@contextlib.contextmanager
def _renderer_errors(scenario: Scenario) -> Iterator[None]:
    """Report in one sentence that this machine cannot render."""
    try:
        yield
    except RuntimeError as error:
        # An environment's own class: its package is loaded by path, and nobody can import from it. What a process of
        # its own raised is told by name.
        if "RendererMissingError" not in (type(error).__name__, getattr(error, "kind", None)):
            raise
        raise UserError(f"{scenario.environment}: {error}", code=ExitCode.NOT_RUN) from None


def _render_frame(env: Any, camera: str | None, env_idx: int = 0) -> np.ndarray:
    if not hasattr(env, "render"):
        raise UserError("this environment draws nothing: its client has no render(env_idx, camera)")
    try:
        frame: np.ndarray = env.render(env_idx, camera or sdk.OPTIONAL_CAMERAS[0])
    except ValueError as error:
        raise UserError(str(error)) from None
    return frame


def _format(out: Path) -> str:
    return out.suffix.lower().lstrip(".")


def check_ending(out: Path, endings: tuple[str, ...]) -> None:
    """Raise a UserError for a file that cannot be written, or whose ending is not known."""
    if out.suffix.lower() not in endings:
        raise UserError(f"{out}: the name must end in {' or '.join(endings)}")
    if not out.resolve().parent.is_dir():
        raise UserError(f"{out}: its folder does not exist")
