"""What the last audit of each gate found, kept in the user's cache: whoever was interrupted reads it and goes on.

An audit that was narrowed to some rules proves less than a gate and is not kept, nor is a gate that was not started.
What is kept is worth something as long as the files that an audit reads are the same: `source` tells.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from xpl_cli import __version__
from xpl_cli.audit.rules.model import GateReport, Outcome
from xpl_cli.audit.rules.verdict import Ended

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.audit.rules.model import Result, TargetReport

LIMIT: Final = 1024
"""Packages that are remembered; beyond it the ones that were not audited for the longest time go."""

_MOST_FINDINGS: Final = 20
_TOLD: Final = (Outcome.FAIL, Outcome.ERROR, Outcome.NOT_RUN, Outcome.WARN)
"""Outcomes that are remembered one by one, in order of harm."""


@dataclass(frozen=True)
class Found:
    """The first thing that a rule found, or why it proved nothing.

    Attributes:
        code, slug, outcome: the rule's.
        message: the finding, or the reason.
        path, line: its place in the package, where it has one.
        more: how many findings the rule has besides.
    """

    code: str
    slug: str
    outcome: str
    message: str
    path: str | None = None
    line: int | None = None
    more: int = 0


@dataclass(frozen=True)
class Remembered:
    """How a gate ended when it last ran.

    Attributes:
        outcome: of the gate.
        when: UTC, to the second, as ISO 8601 has it.
        source: hash of the files that it judged.
        tool: version of xpl.
        options: of the audit, beyond the package and the gate.
        finish: its finish line.
        profile: `full` or `shadow`, where it served the adapter.
        stood_in: what stood in for the model, and why.
        found: what was not right, the worst first.
        omitted: how many rules that found something are left out of `found`.
        ended: what a verdict has to know of it.
    """

    outcome: str
    when: str
    source: str
    tool: str
    options: tuple[str, ...]
    finish: str | None
    profile: str | None
    stood_in: str | None
    found: tuple[Found, ...]
    omitted: int
    ended: Ended

    @property
    def settings(self) -> tuple[str, ...]:
        """Keys of deploy.yml that `--set` gave other values."""
        pairs = zip(self.options, self.options[1:], strict=False)
        return tuple(value.partition("=")[0] for option, value in pairs if option == "--set")


def remember(folder: Path, package: Path, report: TargetReport, options: Sequence[str]) -> None:
    """Keep what the gates of an audit found; a cache that cannot be written keeps nothing.

    Args:
        folder: where it is kept.
        package: the package, absolute.
        report: what was found.
        options: of the audit.
    """
    gates = {gate.name.value: asdict(_remembered(gate, options)) for gate in report.gates if gate.source is not None}
    if not gates:
        return
    from xpl_cli.basics import atomic

    with suppress(OSError):
        before = {name: asdict(gate) for name, gate in recall(folder, package).items()}
        folder.mkdir(parents=True, exist_ok=True)
        told = {"path": str(package), "gates": {**before, **gates}}
        atomic.write_file(_file(folder, package), json.dumps(told).encode(), mode=0o600)
        _prune(folder)


def recall(folder: Path, package: Path) -> dict[str, Remembered]:
    """Return what is known of each gate of a package, by its name; a record that cannot be read is none."""
    try:
        told: dict[str, Any] = json.loads(_file(folder, package).read_bytes())
        return {str(name): _read(gate) for name, gate in told["gates"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _remembered(gate: GateReport, options: Sequence[str]) -> Remembered:
    results = [result for outcome in _TOLD for result in gate.results if result.outcome is outcome]
    return Remembered(
        outcome=gate.outcome.value,
        when=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        source=str(gate.source),
        tool=__version__,
        options=tuple(options),
        finish=gate.finish,
        profile=None if gate.profile is None else gate.profile.value,
        stood_in=gate.stood_in,
        found=tuple(map(_found, results[:_MOST_FINDINGS])),
        omitted=max(0, len(results) - _MOST_FINDINGS),
        ended=Ended.of(gate),
    )


def _found(result: Result) -> Found:
    if not result.findings:
        return Found(result.code, result.slug, result.outcome.value, result.reason or "")
    first, *others = result.findings
    return Found(
        result.code, result.slug, result.outcome.value, first.message, first.path, first.line, more=len(others)
    )


def _read(told: dict[str, Any]) -> Remembered:
    lists = {"options": tuple(told["options"]), "found": tuple(Found(**one) for one in told["found"])}
    return Remembered(**{**told, **lists, "ended": Ended.read(told["ended"])})


def _file(folder: Path, package: Path) -> Path:
    return folder / f"{hashlib.sha256(str(package).encode(errors='surrogateescape')).hexdigest()[:32]}.json"


def _prune(folder: Path) -> None:
    records = list(folder.glob("*.json"))
    if len(records) > LIMIT:
        for path in sorted(records, key=lambda path: path.stat().st_mtime)[: len(records) - LIMIT]:
            path.unlink(missing_ok=True)
