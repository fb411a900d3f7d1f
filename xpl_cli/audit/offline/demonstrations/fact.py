"""The demonstrations fact: the actions of a served adapter in recorded episodes, and what explains their errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl.trajectory import TrajectoryError, open_folder
from xpl_cli.audit.offline.demonstrations import declaration
from xpl_cli.audit.offline.demonstrations.action_errors import ActionErrors, ActionPart, ErrorMetric
from xpl_cli.audit.offline.demonstrations.certainty import LEAST_EPISODES, Margin, margin
from xpl_cli.audit.offline.demonstrations.episodes import (
    BatchedReplay,
    EpisodeRecording,
    MissingDataError,
    load_recording,
    make_session,
)
from xpl_cli.audit.offline.demonstrations.search import ConventionSearch, ConventionSearchResult
from xpl_cli.audit.offline.search.replay import QuestionRefusedError, replay_calls
from xpl_cli.audit.rules.model import NotApplicable, NotRun
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.basics.atomic import write_file
from xpl_cli.basics.phrases import count_noun, join_limited

if TYPE_CHECKING:
    from xpl.trajectory import Folder, Trajectory
    from xpl_cli.audit.offline.demonstrations.action_errors import Chunks
    from xpl_cli.audit.offline.demonstrations.episodes import RecordedSession
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.model_io.pairs import Chunk

_MOST_EPISODES: Final = 24
"""Episodes that are looked at, evenly spread over those that are there."""
_MOST_HORIZON: Final = 32
_MOST_BYTES: Final = 256 << 20
"""What the images of all questions may take."""


class DemonstrationComparison:
    """Recorded episodes and the adapter that is compared with them.

    Args:
        probe: the adapter.
    """

    def __init__(self, probe: Probe) -> None:
        self.probe = probe

    @cached_property
    def recordings(self) -> list[EpisodeRecording]:
        """The recorded episodes, 24 at most.

        Raises:
            NotApplicable: no demonstrations are given or declared.
            NotRun: they cannot be read, differ from the declared ones, do not fit the robot, or are too few.
        """
        trajectories = self._episodes()
        if len(trajectories) < LEAST_EPISODES:
            raise NotRun(
                f"{count_noun(len(trajectories), 'episode')} are too few: at least {LEAST_EPISODES} are needed"
            )
        indices = np.unique(np.linspace(0, len(trajectories) - 1, min(len(trajectories), _MOST_EPISODES)).astype(int))
        try:
            return [
                load_recording(trajectories[int(index)], self.probe.embodiment, self.probe.action_type)
                for index in indices
            ]
        except (MissingDataError, TrajectoryError) as error:
            raise NotRun(str(error)) from None

    @cached_property
    def session(self) -> RecordedSession:
        """The questions.

        Raises:
            NotRun: as `recordings`; the model is not here; or the policy reads inputs that were not recorded.
        """
        if self.probe.profile.name is Profile.SHADOW:
            raise NotRun("a comparison with demonstrations needs the real model, which is not available here")
        recordings = self.recordings
        observation = recordings[0].trajectory.observation(0)
        missing = [name for name in self.probe.required if not _has_input(observation, name)]
        if missing:
            raise NotRun(f"the policy requires {', '.join(missing)}, which the demonstrations do not have")
        manifest = self.probe.package.manifest
        temporal, model_io = manifest.temporal, manifest.model_io
        is_recurrent = model_io is not None and model_io.recurrent
        reach = 0 if is_recurrent or temporal.kind == "memory" else manifest.reach
        horizon = min(_MOST_HORIZON, temporal.chunk or 1)
        seed = int(self.probe.config.get(sdk.Deploy.SEED) or 0)
        session_made = make_session(recordings, self.probe.embodiment, self.probe.action_type, seed, horizon, reach)
        size = sum(entry[sdk.Camera.COLOR].nbytes for entry in observation.get(sdk.Obs.VISION, {}).values())
        steps = sum(len(call.show) for call in session_made.calls)
        if size * steps > _MOST_BYTES:
            fewer = max(LEAST_EPISODES, int(len(recordings) * _MOST_BYTES / (size * steps)))
            chosen = recordings[:: -(-len(recordings) // fewer)]
            session_made = make_session(chosen, self.probe.embodiment, self.probe.action_type, seed, horizon, reach)
        return session_made

    @cached_property
    def metric(self) -> ErrorMetric:
        """The error metric of these episodes."""
        return ErrorMetric(self.session)

    @cached_property
    def _answers_and_refusals(self) -> tuple[list[Chunk], dict[int, str]]:
        """The served adapter's answers to all questions, empty where it refused one, and how it refused them.

        Raises:
            NotRun: if it refuses all.
        """
        self.probe.options.time_limit.check()
        replay = BatchedReplay(self.session)
        answers: list[Chunk] = []
        refusals: dict[int, str] = {}
        with self.probe.session() as client:
            for question in self.session.questions:
                number = [question.number]
                try:
                    calls = replay.calls_for(number)
                    answers += [
                        takes[0] for takes in replay_calls(client, self.session, calls, [question], replay.observation)
                    ]
                except QuestionRefusedError as refusal:
                    answers.append([])
                    refusals[question.number] = str(refusal)
        return answers, refusals

    @property
    def answers(self) -> list[Chunk]:
        """The served adapter's answers to all questions, empty where it refused one."""
        return self._answers_and_refusals[0]

    @property
    def refusals(self) -> dict[int, str]:
        """The error of each refused question, by its number."""
        return self._answers_and_refusals[1]

    @property
    def episodes(self) -> int:
        """Number of compared episodes."""
        return len(self.session.recordings)

    @cached_property
    def errors(self) -> ActionErrors:
        """Of the adapter's answers."""
        return self.metric.errors(dict(enumerate(self.answers)), self._all_questions, self.refusals)

    @cached_property
    def baselines(self) -> Mapping[str, ActionErrors]:
        """Errors of holding the pose, and of repeating the action before."""
        chunks: dict[str, Chunks] = {
            "holding the pose": self.metric.hold_pose(),
            "the action before": self.metric.repeat_action(),
        }
        return {name: self.metric.errors(answers, self._all_questions) for name, answers in chunks.items()}

    @cached_property
    def outcome(self) -> ConventionSearchResult:
        """The result of the search for a convention that fits better.

        Raises:
            NotRun: the adapter refuses some of the observations, and no convention explains that.
        """
        result = ConventionSearch(self.probe, self.metric, self.answers, self.refusals).run()
        if result.best is None and self.refusals:
            number, why = next(iter(self.refusals.items()))
            some = f"{len(self.refusals)} of {len(self.answers)} observations"
            episode, step = self.session.question_steps[number]
            where = f"{self.session.recordings[episode].trajectory.key}, step {step}"
            raise NotRun(f"the adapter refuses {some} of the demonstrations, and nothing explains it: {where}: {why}")
        return result

    def margin_to(self, baseline: ActionErrors) -> Margin | None:
        """Return the adapter's error relative to a baseline."""
        return margin(baseline, self.errors, [episode for episode, _ in self.session.question_steps])

    def table(self, changed: ActionErrors | None = None) -> dict[str, dict[str, float]]:
        """Return the errors of each part in its unit: of the adapter, of a change, and of the baselines."""
        rows = {"declared": self.errors, **({} if changed is None else {"changed": changed}), **self.baselines}
        return {name: _round_units(errors.units(self.errors)) for name, errors in rows.items()}

    def save_plot(self, picture: str, name: str) -> str | None:
        """Write a plot if the audit was started with `--pictures`, and return its path, else None."""
        folder = self.probe.options.pictures
        if folder is None:
            return None
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.probe.package.name}-{name}.svg"
        write_file(path, picture.encode())
        return str(path)

    @property
    def _all_questions(self) -> Sequence[int]:
        return range(len(self.session.questions))

    def _episodes(self) -> Sequence[Trajectory]:
        options, package = self.probe.options, self.probe.package.path
        if options.demos is not None:
            return _open_folder(options.demos)
        if not declaration.exists(package):
            raise NotApplicable("no demonstrations were given: --demos PATH")
        try:
            path, digests = declaration.read(package)
        except declaration.DeclarationError as error:
            raise NotRun(str(error)) from None
        root = path if path.is_dir() else path.parent
        if not root.is_dir():
            raise NotRun(f"the demonstrations that {declaration.FILE} names are not here: {path}")
        differing = [name for name, digest in digests.items() if not _has_digest(root / name, root, digest)]
        if differing:
            raise NotRun(
                f"the demonstrations are not those that {declaration.FILE} names: {join_limited(differing, 1)} differ"
            )
        from xpl.trajectory import Trajectory

        return [Trajectory(str(root / name)) for name in sorted(digests)]


def _open_folder(path: Path) -> Folder:
    try:
        return open_folder(path)
    except TrajectoryError as error:
        raise NotRun(str(error)) from None
    except ImportError as error:
        raise NotRun(f"demonstrations need h5py: pip install 'xpolicylab[data]' ({error})") from None


def _has_digest(path: Path, root: Path, digest: str) -> bool:
    if not path.resolve().is_relative_to(root.resolve()) or not path.is_file():
        return False
    return declaration.digest(path) == digest


def _has_input(observation: Mapping[str, object], name: str) -> bool:
    """Tell whether an observation has an input, a field of the state of any arm."""
    group, _, field = name.partition(".")
    inner = observation.get(group)
    if not field:
        return inner is not None
    return isinstance(inner, Mapping) and any(one == field or one.endswith(f"_{field}") for one in inner)


def _round_units(units: Mapping[ActionPart, float]) -> dict[str, float]:
    return {f"{part.name} ({part.unit})": float(f"{value:.3g}") for part, value in units.items()}
