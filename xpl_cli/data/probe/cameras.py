"""Cameras: which are on a wrist, and of which arm; which are upside down; whether blue and red are exchanged."""

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
"""Frames of an episode that are looked at."""
_EDGE: Final = 48
"""Pixels that a picture is made smaller to."""
_SEEN: Final = 10
"""Steps of 256 that a pixel has to change by."""
_EDGES: Final = 24
"""Steps of 256 between neighbours that make an edge."""
_FEWEST: Final = 30
_PAIRS: Final = 8
_MOVING, _FIXED = 0.3, 0.38
"""Shares of its edges that a camera keeps which moves with an arm, at most, and which stands still, at least."""
_STILL: Final = 0.05
"""Way, rad or m, below which an arm has not moved."""
_CLIP: Final = 2000
"""Frames of an episode that are decoded at most."""


def probe_cameras(
    episodes: Sequence[RecordedEpisode],
    arms: Mapping[str, Sequence[np.ndarray]],
    heights: Mapping[str, Sequence[np.ndarray]],
    report_progress: Callable[[str], None],
) -> list[ProbeAnswer]:
    """Return what is known of the cameras.

    Args:
        episodes: of the set.
        arms: of each arm, by episode, its joints or positions (T, D).
        heights: of each arm, by episode, how high it is in the world (T,); empty where that is unknown.
        report_progress: called with one line for each camera.
    """
    places = spread(len(episodes), _EPISODES)
    names = (
        [name for name, camera in episodes[0].cameras.items() if camera.kind == sdk.Camera.COLOR] if episodes else []
    )
    found: list[ProbeAnswer] = []
    for name in names:
        report_progress(f"camera {name}")
        shown: list[tuple[int, np.ndarray, np.ndarray]] = []
        for place in places:
            if name not in episodes[place].cameras:
                continue
            steps, frames = _frames(episodes[place], name)
            if len(steps) > 4:
                shown.append((place, steps, frames))
        if not shown:
            continue
        found.append(_probe_mount(name, shown, arms))
        found.append(_probe_orientation(name, shown, heights, is_wrist=_is_wrist(found[-1])))
        found.append(_probe_channels(name, shown, episodes))
    return found


def _is_wrist(answer: ProbeAnswer) -> bool:
    return bool(answer.value and answer.value != "fixed")


def _frames(episode: RecordedEpisode, camera: str) -> tuple[np.ndarray, np.ndarray]:
    """Return places and pictures (N, h, w, 3) of some frames, evenly spread over the first ones."""
    wanted = set(spread(min(episode.length, _CLIP), _FRAMES))
    kept = []
    for place, frame in enumerate(episode.frames(camera, 0, max(wanted) + 1)):
        if place in wanted:
            step = max(1, -(-max(frame.shape[:2]) // _EDGE))
            kept.append((place, np.asarray(frame[::step, ::step, :3], np.int16)))
    return np.array([place for place, _ in kept]), np.stack([image for _, image in kept]) if kept else np.zeros(0)


def _probe_mount(name: str, shown: Sequence[Any], arms: Mapping[str, Sequence[np.ndarray]]) -> ProbeAnswer:
    """Return whether a camera stands still or moves with an arm: what becomes of its edges once the arm has moved."""
    if not arms:
        return unknown("camera", name, "no arm is known that it could move with", "columns of joints or poses")
    moved: list[list[float]] = []
    kept, changed, edges = [], [], []
    for place, steps, frames in shown:
        lines = _edges(frames)
        ways = [np.linalg.norm(rows[place][steps] - rows[place][steps[0]], axis=1) for rows in arms.values()]
        for far in {int(way.argmax()) for way in ways} | set(spread(len(steps), _PAIRS)):
            both, either = (lines[0] & lines[far]).sum(), (lines[0] | lines[far]).sum()
            kept.append(both / max(either, 1))
            changed.append(float((np.abs(frames[0] - frames[far]).max(-1) > _SEEN).mean()))
            moved.append([float(way[far]) for way in ways])
        edges.append(int(lines[0].sum()))
    most = np.array(moved).max(0)
    if np.median(edges) < _FEWEST:
        return unknown("camera", name, "its picture has hardly any edges", "extrinsics of the camera")
    if most.min() < _STILL:
        still = list(arms)[int(most.argmin())]
        return unknown("camera", name, f"{still} never moves, and it could be its wrist camera", f"motion of {still}")
    return _mount_answer(name, list(arms), np.array(moved), np.array(kept), np.array(changed))


def _mount_answer(name: str, arms: Sequence[str], ways: np.ndarray, left: np.ndarray, seen: np.ndarray) -> ProbeAnswer:
    """Return whether a camera stands still or moves with an arm.

    Args:
        name: the camera's.
        arms: names of the arms.
        ways: of each pair of frames how far each arm moved, (N, arms).
        left: which share of the edges stayed, (N,).
        seen: which share of the picture changed, (N,).
    """
    most = ways.max(0)
    far = ways > 0.6 * most
    shares = [(float(np.median(left[far[:, k]])), float(np.median(seen[far[:, k]]))) for k in range(len(most))]
    stays, changes = min(shares)
    said = f"where an arm is far from its start {100 * stays:.0f} % of its edges stay where they are"
    if stays >= _FIXED and max(share for _, share in shares) <= 0.2:
        return ProbeAnswer("camera", name, "fixed", said, stays / _MOVING)
    if stays > _MOVING or changes < 0.25:
        return unknown("camera", name, f"{said}, neither few nor most", "extrinsics of the camera")
    if len(most) == 1:
        return ProbeAnswer("camera", name, "wrist", said, _FIXED / max(stays, 0.02))
    alone = [far[:, k] & (ways[:, 1 - k] < 0.1 * most[1 - k]) for k in (0, 1)]
    own = [float(np.median(left[rows])) if rows.any() else None for rows in alone]
    for k, mine in enumerate(own):
        other = own[1 - k]
        if mine is None:
            continue
        told = f"{said}; where only {arms[k]} moved, {100 * mine:.0f} %"
        if mine <= _MOVING and (other is None or other >= _FIXED):
            return ProbeAnswer("camera", name, f"wrist of {arms[k]}", told, (other or _FIXED) / max(mine, 0.02))
        if mine >= 2 * _FIXED and other is None:
            return ProbeAnswer("camera", name, f"wrist of {arms[1 - k]}", told, mine / max(stays, 0.02))
    return ProbeAnswer(
        "camera", name, "wrist", f"{said}; the arms move together, so which wrist is open", _FIXED / _MOVING
    )


def _edges(frames: np.ndarray) -> np.ndarray:
    """Return where pictures (N, h, w, 3) have edges, (N, h - 1, w - 1)."""
    grey = frames.astype(float).mean(-1)
    across, down = np.abs(np.diff(grey, axis=2))[:, :-1], np.abs(np.diff(grey, axis=1))[:, :, :-1]
    found: np.ndarray = across + down > _EDGES
    return found


def _probe_orientation(
    name: str, shown: Sequence[Any], heights: Mapping[str, Sequence[np.ndarray]], *, is_wrist: bool
) -> ProbeAnswer:
    """Return whether a fixed camera sees the arm go up where it goes up."""
    if is_wrist or not heights:
        why = "it moves with the arm" if is_wrist else "how high the arm is, is unknown"
        return unknown("orientation", name, why, "a marked picture, or extrinsics")
    rows_seen, climbs = [], []
    for place, steps, frames in shown:
        background = np.median(frames, axis=0)
        there = (np.abs(frames - background).max(-1) > 2 * _SEEN).astype(float)
        weight = there.sum((1, 2))
        rows = (there.sum(2) * np.arange(frames.shape[1])).sum(1) / np.maximum(weight, 1)
        height = max((entry[place][steps] for entry in heights.values()), key=np.ptp)
        kept = weight > 3
        if kept.sum() > 5 and np.ptp(height[kept]) > 0.03:
            rows_seen.append(rows[kept] - rows[kept].mean())
            climbs.append(height[kept] - height[kept].mean())
    if not rows_seen or np.concatenate(rows_seen).std() == 0:
        return unknown("orientation", name, "nothing in it goes up and down", "episodes in which the arm is lifted")
    link = float(np.corrcoef(np.concatenate(rows_seen), np.concatenate(climbs))[0, 1])
    if abs(link) < 0.6:
        why = f"what moves in it goes up and down with the arm by a correlation of {-link:.2f} only"
        return unknown("orientation", name, why, "a marked picture, or extrinsics")
    value = "upright" if link < 0 else "upside down"
    said = f"what moves in it goes {'up' if link < 0 else 'down'} as the arm goes up, correlated by {abs(link):.2f}"
    return ProbeAnswer("orientation", name, value, said, (1 + abs(link)) / (1 - abs(link) + 1e-3))


def _probe_channels(name: str, shown: Sequence[Any], episodes: Sequence[RecordedEpisode]) -> ProbeAnswer:
    """Return whether red things are red, where instructions speak of one and of no blue thing, or vice versa."""
    red_first, blue_first = 0.0, 0.0
    for place, _, frames in shown:
        said = {word for text in episodes[place].instructions for word in words(text.replace(" ", "_"))}
        if ("red" in said) == ("blue" in said):
            continue
        first = frames[0].astype(float)
        strong = first.max(-1) > 60
        red = float((strong & (first[..., 0] > 1.8 * first[..., 1:].max(-1))).mean())
        blue = float((strong & (first[..., 2] > 1.8 * first[..., :2].max(-1))).mean())
        if "blue" in said:
            red, blue = blue, red
        red_first, blue_first = red_first + red, blue_first + blue
    floor = 0.002 * max(len(shown), 1)
    if max(red_first, blue_first) < floor or max(red_first, blue_first) < 4 * min(red_first, blue_first):
        why = "nothing in it is known to be red or blue"
        return unknown("channels", name, why, "instructions that name one red or blue thing, or a marked picture")
    value = "rgb" if red_first > blue_first else "bgr"
    share = max(red_first, blue_first) / max(min(red_first, blue_first), floor / 4)
    evidence = "what the instruction calls red or blue has that colour, read so"
    return ProbeAnswer("channels", name, value, evidence, share)
