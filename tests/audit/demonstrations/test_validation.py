"""Each check of demonstrations catches a set that is broken in its way, and leaves real motion alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy

import numpy as np
import pytest

from tests.support.recordings.demonstrations import Convention, MemorySet, write
from tests.support.recordings.motion import motion
from xpl_cli.audit.demonstrations import catalogue
from xpl_cli.audit.demonstrations.validation import ValidationOptions, validate
from xpl_cli.audit.formats import ReportContext, render
from xpl_cli.audit.rules.model import Outcome, exit_code
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.formats import REPORTS

pytest.importorskip("mujoco")

POSED = Convention(state=("position", "rotation", "gripper"), beside=True, stamps=("timestamp", 1.0))


@pytest.fixture(scope="module")
def kept() -> MemorySet:
    """Real motion, with pictures of a scene that is neither symmetric nor grey."""
    episodes = write(
        [motion("lift_cube", "franka_single", seed) for seed in range(2)] * 2, POSED, robot="franka_single"
    )
    for number, episode in enumerate(episodes.episodes):
        episode.key = f"episode_{number:06d}"
        episode.images["head"] = np.stack([_scene(number, step) for step in range(episode.length)])
    return episodes


@pytest.fixture
def whole(kept: MemorySet) -> MemorySet:
    """A copy that a test may break."""
    return deepcopy(kept)


def _scene(number: int, step: int) -> np.ndarray:
    """Return a picture (24, 32, 3): a red thing at the left, a blue one below, and noise that differs in each step."""
    image = np.random.default_rng((number, step)).integers(90, 110, (24, 32, 3)).astype(np.uint8)
    image[4:14, 2:12] = (220, 30, 30)
    image[16:22, 8:20] = (30, 30, 210)
    return image


def _of(demonstrations: MemorySet, **options: object) -> dict[str, Outcome]:
    """Return how each check ends."""
    report = validate(demonstrations, "demos", ValidationOptions(**options))
    return {result.code: result.outcome for result in report.results}


def test_real_motion_has_no_findings(kept: MemorySet) -> None:
    """All checks hold on it, and each of them had something to look at."""
    assert set(_of(kept).values()) == {Outcome.PASS}


def _schema(whole: MemorySet) -> None:
    whole.episodes[1].numbers["observation.state"] = whole.episodes[1].numbers["observation.state"][:, :-1]


def _time(whole: MemorySet) -> None:
    whole.episodes[1].numbers["timestamp"][20:] -= 1.0


def _gap(whole: MemorySet) -> None:
    whole.episodes[1].numbers["timestamp"][20:] += 1.0


def _frozen(whole: MemorySet) -> None:
    whole.episodes[1].images["head"][10:40] = whole.episodes[1].images["head"][10]


def _limits(whole: MemorySet) -> None:
    whole.episodes[1].numbers["observation.joints"][9, 3] += 3.5


def _gripper(whole: MemorySet) -> None:
    whole.episodes[1].numbers["action"][:, -1] *= 255


def _nan(whole: MemorySet) -> None:
    whole.episodes[1].numbers["action"][7, 2] = np.nan


def _norm(whole: MemorySet) -> None:
    whole.episodes[1].numbers["observation.state"][0, 3:7] = 0


def _sign(whole: MemorySet) -> None:
    whole.episodes[1].numbers["observation.state"][11:, 3:7] *= -1


def _short(whole: MemorySet) -> None:
    whole.episodes[1].images["head"] = whole.episodes[1].images["head"][:-1]


def _copy(whole: MemorySet) -> None:
    for episode in whole.episodes:
        episode.numbers["action_joints"] = episode.numbers["observation.joints"].copy()


def _told_nothing(whole: MemorySet) -> None:
    whole.episodes[1].instructions = ("  ",)


def _mirrored(whole: MemorySet) -> None:
    whole.episodes[1].images["head"] = whole.episodes[1].images["head"][:, :, ::-1]


def _exchanged(whole: MemorySet) -> None:
    whole.episodes[1].images["head"] = whole.episodes[1].images["head"][..., ::-1]


def _constant(whole: MemorySet) -> None:
    for episode in whole.episodes:
        episode.numbers["observation.joints"][:, 4] = 0.1


BROKEN: dict[str, tuple[Callable[[MemorySet], None], str, Outcome]] = {
    "shape": (_schema, "XPL701", Outcome.FAIL),
    "back in time": (_time, "XPL702", Outcome.FAIL),
    "gap": (_gap, "XPL702", Outcome.WARN),
    "frozen": (_frozen, "XPL703", Outcome.WARN),
    "limits": (_limits, "XPL704", Outcome.FAIL),
    "gripper": (_gripper, "XPL705", Outcome.FAIL),
    "nan": (_nan, "XPL706", Outcome.FAIL),
    "norm": (_norm, "XPL707", Outcome.FAIL),
    "sign": (_sign, "XPL708", Outcome.WARN),
    "short video": (_short, "XPL709", Outcome.FAIL),
    "copy": (_copy, "XPL710", Outcome.FAIL),
    "language": (_told_nothing, "XPL711", Outcome.WARN),
    "mirrored": (_mirrored, "XPL712", Outcome.FAIL),
    "blue and red": (_exchanged, "XPL713", Outcome.FAIL),
    "constant": (_constant, "XPL714", Outcome.WARN),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_found_and_nothing_else(name: str, whole: MemorySet) -> None:
    """One fault, one check; the finding names the episode where only one has it."""
    spoil, code, outcome = BROKEN[name]
    spoil(whole)
    report = validate(whole, "demos", ValidationOptions(names=(code,)))
    (result,) = report.results
    assert result.outcome is outcome, result.reason
    if name not in {"copy", "constant"}:
        assert "episode_000001" in result.findings[0].message
        assert "1 of 4 episodes" in result.findings[0].message


def test_the_wrist_camera_of_an_arm_that_stands_still_is_not_frozen(whole: MemorySet) -> None:
    """The other arm's motion says nothing of it."""
    for episode in whole.episodes:
        episode.numbers["left_joints"] = np.zeros((episode.length, 6))
        episode.numbers["right_joints"] = episode.numbers.pop("observation.joints")
        del episode.numbers["observation.state"]
        for side in ("left", "right"):
            episode.images[f"{side}_wrist"] = np.repeat(episode.images["head"][:1], episode.length, axis=0)
    (result,) = validate(whole, "demos", ValidationOptions(names=("XPL703",))).results
    assert [finding.message.partition(" ")[0] for finding in result.findings] == ["right_wrist"]


def test_every_check_has_a_broken_set() -> None:
    """And a page that explains it, under the headings that rules have."""
    assert {code for _, code, _ in BROKEN.values()} == {check.code for check in catalogue.CHECKS}
    for check in catalogue.CHECKS:
        heads = [line for line in check.documentation.splitlines() if line.startswith("## ")]
        assert heads == ["## What it does", "## Why it matters", "## Example", "## Use instead", "## Fix safety"]


def test_a_set_is_read_episode_by_episode(kept: MemorySet) -> None:
    """No episode is asked for before the one ahead of it was done with, so that a set may be larger than memory."""
    alive: list[int] = []

    class Lazy:
        rate_hz, robot, path, format, extras = None, None, "lazy", "memory", {}

        def __len__(self) -> int:
            return 50

        def __getitem__(self, index: int) -> object:
            alive.append(index)
            return kept.episodes[index % 4]

    report = validate(Lazy(), "lazy", ValidationOptions(episodes=3, images=False, names=("XPL706",)))
    assert alive[-3:] == [0, 24, 49]
    assert report.circumstances.narrowed.startswith("3 of 50 episodes")


def test_what_is_waived_counts_no_more(whole: MemorySet) -> None:
    """And the report says why; a name that is no check is a mistake of the user."""
    _nan(whole)
    options = ValidationOptions(names=("XPL706",), waived={"not-finite": "cut when converting"}, images=False)
    report = validate(whole, "demos", options)
    assert exit_code([report]) is ExitCode.CLEAN
    assert report.results[0].waived[0].reason == "cut when converting"
    with pytest.raises(UserError, match="XPL799"):
        validate(whole, "demos", ValidationOptions(names=("XPL799",)))


@pytest.mark.parametrize("name", [name for name in REPORTS if name != "json"])
def test_every_format_tells_it(name: str, whole: MemorySet) -> None:
    """Code and episode stand in each; SARIF explains the check."""
    _nan(whole)
    report = validate(whole, "demos", ValidationOptions(names=("XPL706",), images=False))
    context = ReportContext(rule=catalogue.find, command=("xpl", "data", "validate"))
    text = render(name, [report], context)
    assert "XPL706" in text
    assert "episode_000001" in text.replace("\\", "")
    if name == "sarif":
        (rule,) = json.loads(text)["runs"][0]["tool"]["driver"]["rules"]
        assert rule["shortDescription"]["text"] == catalogue.find("XPL706").summary
    if name == "text":
        assert "xpl explain XPL706" in text
