"""Verify a bundle: its files, its records, its claims, and a sample of its episodes by replay.

Everything but the replay only reads. The replay runs the adapter of the bundle, as any evaluation of it would; it is
skipped if any check fails.
"""

from __future__ import annotations

import secrets
import tempfile
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.progress import Progress
from xpl_cli.evaluation.rollout.config import Runtime
from xpl_cli.standard import spec
from xpl_cli.submission import bundle, inspection, replay
from xpl_cli.submission.replay_runner import ReplayRunner

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.rules.verdict import Verdict
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.runs.protocol import SeedCoverage
    from xpl_cli.submission.bundle import SubmissionBundle
    from xpl_cli.submission.claims import RunClaim
    from xpl_cli.submission.inspection import BundleCheck


@dataclass(frozen=True)
class VerifyRequest:
    """What to verify, and how.

    Attributes:
        path: the bundle.
        sample: episodes to replay, at most; 0 for none.
        seed: of the sample; random by default, so that the maker of the bundle cannot know it.
        policy: adapter to replay instead of the one in the bundle; it must have the same files.
        folder: new folder to unpack into and leave; a temporary one by default.
        limit: most bytes that are unpacked.
        runtime: of adapter and environment of the replay.
        progress: where to report progress.
    """

    path: Path
    sample: int = 5
    seed: int | None = None
    policy: Path | None = None
    folder: Path | None = None
    limit: int = 10**10
    runtime: Runtime = field(default_factory=Runtime)
    progress: Progress = field(default_factory=Progress)


@dataclass(frozen=True)
class VerificationReport:
    """The result of a verification.

    Attributes:
        digest: the bundle's name.
        policy: name of the evaluated policy.
        runs: claims of the bundle (`runs` of its manifest).
        checks: with their problems.
        verdict: on the adapter, as it follows from the findings in its audit; None if the audit cannot be read.
        seed: of the sample.
        pairs: run and episode, as recorded and as replayed.
        finding: the result of the sample; None if none was requested.
        replay_skipped: why no episode was run although it was requested.
        parts: coverage of the evaluation seeds; None if it is unknown here.
    """

    digest: str
    policy: str
    runs: tuple[RunClaim, ...]
    checks: tuple[BundleCheck, ...]
    verdict: Verdict | None = None
    seed: int | None = None
    pairs: tuple[tuple[str, replay.ReplayPair], ...] = ()
    finding: replay.SampleResult | None = None
    replay_skipped: str | None = None
    parts: Sequence[SeedCoverage] | None = None

    @property
    def code(self) -> ExitCode:
        """Exit code: findings before undecided results."""
        disagrees = self.finding is not None and self.finding.verdict is replay.ReplayVerdict.DISAGREES
        if disagrees or any(check.problems for check in self.checks):
            return ExitCode.FINDINGS
        undecided = self.finding is not None and self.finding.verdict is replay.ReplayVerdict.UNDECIDED
        return ExitCode.NOT_RUN if undecided or self.replay_skipped else ExitCode.CLEAN

    def as_json(self) -> dict[str, Any]:
        """Return the report as the map that `xpl verify --json` prints."""
        replay_json = None
        if self.finding is not None:
            episodes = [pair.as_json(run) for run, pair in self.pairs]
            replay_json = {"drawn_with": self.seed, **self.finding.as_json(), "episodes": episodes}
        return {
            "schema": spec.schema("verification")["title"],
            "bundle": self.digest,
            "policy": self.policy,
            "runs": [asdict(run) for run in self.runs],
            "audit": None if self.verdict is None else self.verdict.as_json(),
            "checks": [{"name": check.name, "problems": list(check.problems)} for check in self.checks],
            "replay": replay_json,
            "coverage": None if self.parts is None else [asdict(part) for part in self.parts],
            "replay_skipped": self.replay_skipped,
            "exit_code": int(self.code),
        }


def verify(request: VerifyRequest) -> VerificationReport:
    """Verify a bundle and replay a sample of it.

    Raises:
        NotFoundError: there is no such bundle.
        UserError: it is no bundle, or the folder to unpack into exists.
    """
    with _folder(request.folder) as name:
        request.progress.step(f"{request.path.name}: unpacking")
        unpacked = bundle.open_bundle(request.path, Path(name), limit=request.limit)
        checks, runs = inspection.inspect(unpacked, request.progress)
        manifest = unpacked.manifest
        report = VerificationReport(
            unpacked.digest, manifest.policy.name, tuple(manifest.runs), checks, inspection.verdict(unpacked, checks)
        )
        is_sound = not any(check.problems for check in checks)
        if is_sound:
            report = replace(report, parts=inspection.seed_coverage(runs))
        if not request.sample:
            return report
        if not is_sound:
            return replace(report, replay_skipped="what is wrong above comes first")
        return _with_replay(request, unpacked, report, runs)


def _folder(requested: Path | None) -> AbstractContextManager[str]:
    """Give an empty folder: a new one that stays, or one that goes."""
    if requested is None:
        return tempfile.TemporaryDirectory(prefix="xpl-verify-")
    try:
        requested.mkdir(parents=True)
    except OSError as error:
        raise UserError(f"{requested} cannot be made: {error.strerror}", hint="--unpack takes a new folder") from None
    return nullcontext(str(requested))


def _with_replay(
    request: VerifyRequest, unpacked: SubmissionBundle, report: VerificationReport, runs: Sequence[Run]
) -> VerificationReport:
    """Return the report with the result of a replayed sample."""
    seed = secrets.randbits(32) if request.seed is None else request.seed
    drawn = replay.draw(runs, request.sample, seed)
    pairs: list[tuple[str, replay.ReplayPair]] = []
    player = ReplayRunner(
        request.policy or unpacked.adapter,
        variant=unpacked.manifest.policy.variant,
        is_ours=request.policy is not None,
        runtime=request.runtime,
        progress=request.progress,
    )
    try:
        for run in runs:
            indices = [index for one, index in drawn if one is run]
            pairs += [(run.plan.run, pair) for pair in player.replay(run, indices)]
    except UserError as error:
        reason = f"{error}" if error.hint is None else f"{error} ({error.hint})"
        return replace(report, seed=seed, pairs=tuple(pairs), replay_skipped=reason)
    total = sum(len(replay.eligible(run)) for run in runs)
    finding = replay.judge([pair for _, pair in pairs], total, deterministic=player.is_deterministic)
    return replace(report, seed=seed, pairs=tuple(pairs), finding=finding)
