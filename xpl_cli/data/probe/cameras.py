"""Cameras: which are wrist cameras, and of which arm; which are upside down; whether red and blue are swapped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import _spec as sdk
from xpl_cli.data.probe.answer import ProbeAnswer, unknown
from xpl_cli.data.probe.sample import spread, words

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from xpl_cli.data.sets.interface import RecordedEpisode

_EPISODES: Final = 6
_FRAMES: Final = 40
"""Frames of an episode that are analysed."""
_EDGE: Final = 48
"""Longer side of a downscaled image, pixels."""
_SEEN: Final = 10
"""Least change of a pixel, of 256 levels."""
_EDGES: Final = 24
"""Least difference between neighbours at an edge, of 256 levels."""
_FEWEST: Final = 30
_PAIRS: Final = 8
_MOVING, _FIXED = 0.3, 0.38
"""Share of edges that stay: at most for a camera that moves with an arm, at least for a fixed one."""
_STILL: Final = 0.05
"""Distance, rad or m, below which an arm has not moved."""
_CLIP: Final = 2000
"""Most frames of an episode that are decoded."""


def probe_cameras(
    episodes: Sequence[RecordedEpisode],
    arms: Mapping[str, Sequence[np.ndarray]],
    heights: Mapping[str, Sequence[np.ndarray]],
    report_progress: Callable[[str], None],
) -> list[ProbeAnswer]:
    """Return mount, orientation and channel order of each camera.

    Args:
        episodes: of the dataset.
        arms: of each arm, by episode, its joints or positions (T, D).
        heights: of each arm, by episode, its height (T,); empty where that is unknown.
        report_progress: called with one line for each camera.
    """
    indices = spread(len(episodes), _EPISODES)
    names = (
        [name for name, camera in episodes[0].cameras.items() if camera.kind == sdk.Camera.COLOR] if episodes else []
    )
    answers: list[ProbeAnswer] = []
    for name in names:
        report_progress(f"camera {name}")
        samples: list[tuple[int, np.ndarray, np.ndarray]] = []
        for index in indices:
            if name not in episodes[index].cameras:
                continue
            steps, frames = _frames(episodes[index], name)
            if len(steps) > 4:
                samples.append((index, steps, frames))
        if not samples:
            continue
        answers.append(_probe_mount(name, samples, arms))
        answers.append(_probe_orientation(name, samples, heights, is_wrist=_is_wrist(answers[-1])))
        answers.append(_probe_channels(name, samples, episodes))
    return answers


def _is_wrist(answer: ProbeAnswer) -> bool:
    return bool(answer.value and answer.value != "fixed")


def _frames(episode: RecordedEpisode, camera: str) -> tuple[np.ndarray, np.ndarray]:
    """Return steps and downscaled images (N, h, w, 3) of frames, evenly spread over the first 2,000."""
    chosen_steps = set(spread(min(episode.length, _CLIP), _FRAMES))
    sampled = []
    for step_index, frame in enumerate(episode.frames(camera, 0, max(chosen_steps) + 1)):
        if step_index in chosen_steps:
            step = max(1, -(-max(frame.shape[:2]) // _EDGE))
            sampled.append((step_index, np.asarray(frame[::step, ::step, :3], np.int16)))
    return np.array([step_index for step_index, _ in sampled]), np.stack(
        [image for _, image in sampled]
    ) if sampled else np.zeros(0)


def _probe_mount(name: str, samples: Sequence[Any], arms: Mapping[str, Sequence[np.ndarray]]) -> ProbeAnswer:
    """Return whether a camera is fixed or moves with an arm, by the edges that stay after the arm has moved."""
    if not arms:
        return unknown("camera", name, "no arm was found that it could move with", "columns of joints or poses")
    moved: list[list[float]] = []
    edge_shares, changed, edges = [], [], []
    for index, steps, frames in samples:
        lines = _edges(frames)
        ways = [np.linalg.norm(rows[index][steps] - rows[index][steps[0]], axis=1) for rows in arms.values()]
        for far in {int(way.argmax()) for way in ways} | set(spread(len(steps), _PAIRS)):
            both, either = (lines[0] & lines[far]).sum(), (lines[0] | lines[far]).sum()
            edge_shares.append(both / max(either, 1))
            changed.append(float((np.abs(frames[0] - frames[far]).max(-1) > _SEEN).mean()))
            moved.append([float(way[far]) for way in ways])
        edges.append(int(lines[0].sum()))
    most = np.array(moved).max(0)
    if np.median(edges) < _FEWEST:
        return unknown("camera", name, "its image has hardly any edges", "extrinsics of the camera")
    if most.min() < _STILL:
        still = list(arms)[int(most.argmin())]
        return unknown("camera", name, f"{still} never moves, and it could be its wrist camera", f"motion of {still}")
    return _mount_answer(name, list(arms), np.array(moved), np.array(edge_shares), np.array(changed))


def _mount_answer(
    name: str, arms: Sequence[str], ways: np.ndarray, left: np.ndarray, changed: np.ndarray
) -> ProbeAnswer:
    """Return whether a camera is fixed or moves with an arm.

    Args:
        name: the camera's.
        arms: names of the arms.
        ways: distance that each arm moved between the frames of each pair, (N, arms).
        left: share of the edges that stayed, (N,).
        changed: share of the pixels that changed, (N,).
    """
    most = ways.max(0)
    far = ways > 0.6 * most
    shares = [(float(np.median(left[far[:, k]])), float(np.median(changed[far[:, k]]))) for k in range(len(most))]
    stays, changes = min(shares)
    evidence = f"where an arm is far from its start {100 * stays:.0f} % of its edges stay where they are"
    if stays >= _FIXED and max(share for _, share in shares) <= 0.2:
        return ProbeAnswer("camera", name, "fixed", evidence, stays / _MOVING)
    if stays > _MOVING or changes < 0.25:
        return unknown("camera", name, f"{evidence}, neither few nor most", "extrinsics of the camera")
    if len(most) == 1:
        return ProbeAnswer("camera", name, "wrist", evidence, _FIXED / max(stays, 0.02))
    alone = [far[:, k] & (ways[:, 1 - k] < 0.1 * most[1 - k]) for k in (0, 1)]
    own = [float(np.median(left[rows])) if rows.any() else None for rows in alone]
    for k, mine in enumerate(own):
        other = own[1 - k]
        if mine is None:
            continue
        detail = f"{evidence}; where only {arms[k]} moved, {100 * mine:.0f} %"
        if mine <= _MOVING and (other is None or other >= _FIXED):
            return ProbeAnswer("camera", name, f"wrist of {arms[k]}", detail, (other or _FIXED) / max(mine, 0.02))
        if mine >= 2 * _FIXED and other is None:
            return ProbeAnswer("camera", name, f"wrist of {arms[1 - k]}", detail, mine / max(stays, 0.02))
    return ProbeAnswer(
        "camera", name, "wrist", f"{evidence}; the arms move together, so which wrist is open", _FIXED / _MOVING
    )


def _edges(frames: np.ndarray) -> np.ndarray:
    """Return the edge mask (N, h - 1, w - 1) of images (N, h, w, 3)."""
    grey = frames.astype(float).mean(-1)
    across, down = np.abs(np.diff(grey, axis=2))[:, :-1], np.abs(np.diff(grey, axis=1))[:, :, :-1]
    is_edge: np.ndarray = across + down > _EDGES
    return is_edge


def _probe_orientation(
    name: str, samples: Sequence[Any], heights: Mapping[str, Sequence[np.ndarray]], *, is_wrist: bool
) -> ProbeAnswer:
    """Return whether a fixed camera is upright: motion in its image goes up when the arm does."""
    if is_wrist or not heights:
        why = "it moves with the arm" if is_wrist else "how high the arm is, is unknown"
        return unknown("orientation", name, why, "a marked image, or extrinsics")
    rows_seen, climbs = [], []
    for index, steps, frames in samples:
        background = np.median(frames, axis=0)
        changed = (np.abs(frames - background).max(-1) > 2 * _SEEN).astype(float)
        weight = changed.sum((1, 2))
        rows = (changed.sum(2) * np.arange(frames.shape[1])).sum(1) / np.maximum(weight, 1)
        height = max((entry[index][steps] for entry in heights.values()), key=np.ptp)
        has_motion = weight > 3
        if has_motion.sum() > 5 and np.ptp(height[has_motion]) > 0.03:
            rows_seen.append(rows[has_motion] - rows[has_motion].mean())
            climbs.append(height[has_motion] - height[has_motion].mean())
    if not rows_seen or np.concatenate(rows_seen).std() == 0:
        return unknown("orientation", name, "nothing in it goes up and down", "episodes in which the arm is lifted")
    link = float(np.corrcoef(np.concatenate(rows_seen), np.concatenate(climbs))[0, 1])
    if abs(link) < 0.6:
        why = f"what moves in it goes up and down with the arm by a correlation of {-link:.2f} only"
        return unknown("orientation", name, why, "a marked image, or extrinsics")
    value = "upright" if link < 0 else "upside down"
    evidence = f"what moves in it goes {'up' if link < 0 else 'down'} as the arm goes up, correlated by {abs(link):.2f}"
    return ProbeAnswer("orientation", name, value, evidence, (1 + abs(link)) / (1 - abs(link) + 1e-3))


def _probe_channels(name: str, samples: Sequence[Any], episodes: Sequence[RecordedEpisode]) -> ProbeAnswer:
    """Return the channel order, by red or blue objects that instructions name."""
    red_first, blue_first = 0.0, 0.0
    for index, _, frames in samples:
        vocabulary = {word for text in episodes[index].instructions for word in words(text.replace(" ", "_"))}
        if ("red" in vocabulary) == ("blue" in vocabulary):
            continue
        first = frames[0].astype(float)
        strong = first.max(-1) > 60
        red = float((strong & (first[..., 0] > 1.8 * first[..., 1:].max(-1))).mean())
        blue = float((strong & (first[..., 2] > 1.8 * first[..., :2].max(-1))).mean())
        if "blue" in vocabulary:
            red, blue = blue, red
        red_first, blue_first = red_first + red, blue_first + blue
    floor = 0.002 * max(len(samples), 1)
    if max(red_first, blue_first) < floor or max(red_first, blue_first) < 4 * min(red_first, blue_first):
        why = "nothing in it is known to be red or blue"
        return unknown("channels", name, why, "instructions that name one red or blue object, or a marked image")
    value = "rgb" if red_first > blue_first else "bgr"
    share = max(red_first, blue_first) / max(min(red_first, blue_first), floor / 4)
    evidence = "what the instruction calls red or blue has that colour, read so"
    return ProbeAnswer("channels", name, value, evidence, share)
