"""How far a policy is from demonstrations, how sure that is, and which episodes may be asked about."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from xpl import get_embodiment
from xpl.conventions.chunk import rates
from xpl.manifest import Manifest
from xpl.trajectory import open_folder
from xpl_cli.audit.offline.demonstrations import declaration, scripted
from xpl_cli.audit.offline.demonstrations.action_errors import (
    GRIPPER,
    JOINTS,
    POSITION,
    ROTATION,
    ActionErrors,
    ErrorMetric,
)
from xpl_cli.audit.offline.demonstrations.certainty import LEAST_EPISODES, margin
from xpl_cli.audit.offline.demonstrations.episodes import (
    BatchedReplay,
    MissingDataError,
    load_recording,
    make_session,
    select_few,
)
from xpl_cli.audit.offline.demonstrations.error_plot import plot_errors
from xpl_cli.audit.offline.demonstrations.fact import DemonstrationComparison
from xpl_cli.audit.rules.model import NotApplicable, NotRun
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.basics.errors import UserError

ROBOT = "franka_single"
HORIZON = 4


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package that names six demonstrations."""
    folder = tmp_path_factory.mktemp("package")
    (folder / "policy.yml").write_text("spec: v1\n")
    scripted.write(folder, ROBOT, 6)
    return folder


@pytest.fixture(scope="module")
def metric(package: Path) -> ErrorMetric:
    """Measures against them."""
    robot = get_embodiment(ROBOT)
    recordings = [load_recording(one, robot, "joint") for one in open_folder(package / "demonstrations")]
    return ErrorMetric(make_session(recordings, robot, "joint", 0, HORIZON, 1))


def _done(metric: ErrorMetric) -> dict[int, Any]:
    return {question.number: metric.session.chunk(question) for question in metric.session.questions}


def _everything(metric: ErrorMetric) -> range:
    return range(len(metric.session.questions))


# -- measuring ---------------------------------------------------------------------------------------------------------


def test_what_was_done_is_no_error_and_standing_still_is_one(metric: ErrorMetric) -> None:
    own = metric.errors(_done(metric), _everything(metric))
    assert own.units() == {JOINTS: 0.0, GRIPPER: 0.0}
    still, before = (metric.errors(said, _everything(metric)) for said in (metric.hold_pose(), metric.repeat_action()))
    assert 0.02 < still.units()[JOINTS] < 0.5
    assert before.units()[JOINTS] == pytest.approx(still.units()[JOINTS])  # the expert's arm is where it was sent


def test_a_refused_question_is_as_wrong_as_can_be_and_one_without_answer_is_unknown(metric: ErrorMetric) -> None:
    """So that a convention under which nothing is refused fits better."""
    answers = {**_done(metric), 0: [], 1: []}
    errors = metric.errors(answers, _everything(metric), {0})
    assert errors.steps[0, 0] == 3.0
    assert np.isnan(errors.steps[1]).all()
    assert errors.units()[JOINTS] == 0.0


def test_who_stands_still_is_told_from_who_moves(metric: ErrorMetric) -> None:
    """A change that takes all motion away is no convention."""
    assert metric.motion_share(_done(metric), _everything(metric)) == pytest.approx(1.0)
    assert metric.motion_share(metric.hold_pose(), _everything(metric)) == 0.0
    assert np.isnan(metric.motion_share({}, _everything(metric)))


def test_poses_are_not_made_up_where_none_were_observed(package: Path) -> None:
    """What was commanded follows from kinematics; where the flange was is a witness that has to be recorded."""
    episode = next(iter(open_folder(package / "demonstrations")))
    with pytest.raises(MissingDataError, match="ee_pose"):
        load_recording(episode, get_embodiment(ROBOT), "ee")


def test_errors_of_poses_know_no_sign() -> None:
    from xpl_cli.audit.offline.demonstrations.action_errors import _distances

    pose = np.array([[0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]])
    other = np.array([[0.1, 0.2, 0.4, 0.0, -1.0, 0.0, 0.0]])
    assert np.allclose(_distances("ee_pose", pose, other), [[0.0, 0.0, 0.1, np.pi]])
    assert np.allclose(_distances("ee_pose", pose, pose * [1, 1, 1, -1, -1, -1, -1]), 0.0)
    assert {POSITION.unit, ROTATION.unit} == {"m", "rad"}


# -- certainty ---------------------------------------------------------------------------------------------------------


def _errors(steps: np.ndarray) -> ActionErrors:
    return ActionErrors((JOINTS,), steps[..., None], steps[..., None])


def test_a_gain_in_all_episodes_is_certain_and_one_in_half_of_them_is_not() -> None:
    """What is not certain says how many episodes would do."""
    before, episodes = np.ones((12, 2)), list(range(12))
    sure = margin(_errors(before), _errors(0.5 * before), episodes)
    assert sure is not None
    assert sure.is_certain
    assert sure.share == sure.least == sure.most == 0.5
    some = np.where(np.arange(12)[:, None] % 3 == 0, 0.2, 1.0) * before
    unsure = margin(_errors(before), _errors(some), episodes)
    assert unsure is not None
    assert unsure.is_better
    assert not unsure.is_certain
    assert unsure.needed > 12


def test_unknown_steps_gain_nothing() -> None:
    """Else a change that leaves out what is hard would fit best."""
    before = np.tile([1.0, 3.0], (6, 1))
    after = np.tile([0.5, np.nan], (6, 1))
    margin_found = margin(_errors(before), _errors(after), range(6))
    assert margin_found is not None
    assert margin_found.share == pytest.approx(3.5 / 4.0)
    assert margin(_errors(before), _errors(np.full((6, 2), np.nan)), range(6)) is None


def test_nothing_is_better_than_no_error() -> None:
    """A policy that is exact has no margin to any change."""
    nought = _errors(np.zeros((6, 2)))
    assert margin(nought, nought, range(6)) is None


# -- asking ------------------------------------------------------------------------------------------------------------


def test_questions_are_asked_beside_each_other_with_their_histories(metric: ErrorMetric) -> None:
    """An environment whose history is shorter joins later; all are asked about in the end."""
    made = make_session(metric.session.recordings, get_embodiment(ROBOT), "joint", 0, HORIZON, 3)
    early = next(number for number, (_, step) in enumerate(made.question_steps) if step == 0)
    late = next(number for number, (_, step) in enumerate(made.question_steps) if step > 3)
    questions = sorted((early, late))
    reset, *observations, ask = BatchedReplay(made).calls_for(questions)
    assert reset.reset
    assert [len(call.show) for call in observations] == [1, 1, 2]
    assert ask.ask == (0, 1)
    assert {made.questions[number].recipes[-1][1] for number in questions} == {
        place for _, place in observations[-1].show
    }


def test_the_first_tries_are_of_all_episodes(metric: ErrorMetric) -> None:
    chosen = select_few(metric.session.question_steps)
    assert {metric.session.question_steps[number][0] for number in chosen} == set(range(6))
    assert len(chosen) <= 12


def test_rates_stretch_and_shorten_a_chunk() -> None:
    """Steps of a slower model are interpolated; what a chunk does not reach is unknown."""
    chunk = [{"arm_joint_state": np.array([float(step)])} for step in range(1, 5)]
    scaled_chunks = {
        one.description: one.change_actions([[*chunk]], [{}], [0])[0]
        for one in rates()
        if one.change_actions is not None
    }
    values = {
        words: [None if step is None else float(step["arm_joint_state"][0]) for step in steps]
        for words, steps in scaled_chunks.items()
    }
    assert values["rate: half of the control rate"] == [None, 1.0, 1.5, 2.0]
    assert values["rate: twice the control rate"] == [2.0, 4.0, None, None]


def test_a_picture_shows_the_number_that_is_mended(metric: ErrorMetric) -> None:
    """As SVG, small, with nothing of a name read as markup."""
    done = _done(metric)
    key = "ee_joint_state"
    wrong = {number: [{**step, key: 1.0 - step[key]} for step in chunk] for number, chunk in done.items()}
    picture, part = plot_errors(metric, wrong, done, "a < b")
    assert part == f"{key}[0]"
    assert picture.startswith("<svg ")
    assert "a &lt; b" in picture
    assert len(picture) < 16_000


# -- which demonstrations ----------------------------------------------------------------------------------------------


def _probe(package: Path, demos: Path | None = None, robot: str = ROBOT) -> Any:
    return SimpleNamespace(
        package=SimpleNamespace(path=package, manifest=Manifest(), name="Foo"),
        options=AuditOptions(demos=demos),
        embodiment=get_embodiment(robot),
        action_type="joint",
        profile=SimpleNamespace(name=Profile.SHADOW),
        required=(),
    )


def test_a_package_names_its_demonstrations(package: Path) -> None:
    assert len(DemonstrationComparison(_probe(package)).recordings) == 6
    with pytest.raises(NotApplicable, match="--demos"):
        DemonstrationComparison(_probe(package / "demonstrations")).recordings  # noqa: B018 - what is asked for


def test_other_files_than_were_declared_are_not_held_against_it(package: Path, tmp_path: Path) -> None:
    """A digest that differs, a file that is gone, one outside, and a file that is none."""
    path, digests = declaration.read(package)
    for named in ({**digests, "episode_0000000.hdf5": "0" * 64}, {"gone.hdf5": "0" * 64}, {"../x": "0" * 64}):
        (tmp_path / declaration.FILE).write_text(declaration.render(str(path), named))
        with pytest.raises(NotRun, match="are not those that"):
            DemonstrationComparison(_probe(tmp_path)).recordings  # noqa: B018 - what is asked for
    (tmp_path / declaration.FILE).write_text("demonstrations: [1]\n")
    with pytest.raises(NotRun, match="demonstrations"):
        DemonstrationComparison(_probe(tmp_path)).recordings  # noqa: B018 - what is asked for


def test_too_few_episodes_and_another_robot_tell_nothing(package: Path, tmp_path: Path) -> None:
    with pytest.raises(NotRun, match=f"at least {LEAST_EPISODES}"):
        DemonstrationComparison(_probe(package, package / "demonstrations" / "episode_0000000.hdf5")).recordings  # noqa: B018
    with pytest.raises(NotRun, match=f"env_cfg_type={ROBOT}"):
        DemonstrationComparison(_probe(package, package / "demonstrations", "piper_single")).recordings  # noqa: B018


def test_without_the_weights_nothing_is_told(package: Path) -> None:
    with pytest.raises(NotRun, match="needs the real model"):
        DemonstrationComparison(_probe(package)).session  # noqa: B018 - what is asked for


def test_declaring_writes_what_is_read(package: Path, tmp_path: Path) -> None:
    (tmp_path / "policy.yml").write_text("spec: v1\n")
    path, digests = declaration.declare(tmp_path, package / "demonstrations")
    assert path == tmp_path / declaration.FILE
    assert declaration.read(tmp_path) == ((package / "demonstrations").resolve(), digests)
    assert len(digests) == 6
    with pytest.raises(UserError, match=r"policy\.yml"):
        declaration.declare(tmp_path / "nowhere", package)
