"""Plant conversion mistakes, compare each adapter with its golden pairs, and report what was caught and named.

python -m tests.model_io.mutants.trial [NAME...] [--source known] [--json FILE]
"""

from __future__ import annotations

import argparse
import collections
import json
import shutil
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Self

from tests.model_io.mutants.mutants import SOURCES, Adapter, Mutant, read
from xpl_cli.audit.engine import providers
from xpl_cli.audit.engine.checks import Checks
from xpl_cli.audit.rules.facts import Facts
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome, RuleResult
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.registry import select
from xpl_cli.model_io import names, record
from xpl_cli.packages.package import load

PARITY = "golden-parity"


@dataclass(frozen=True)
class Trial:
    """What became of a mutant.

    Attributes:
        outcome: of the parity rule.
        message: of its first finding, or why there is none.
        convention: the cause that it names, None if none.
        conventions: all that it names: of two mistakes two.
        words: that cause in the finding's words.
    """

    outcome: str
    message: str
    convention: str | None = None
    words: str | None = None
    conventions: tuple[str, ...] = ()

    @classmethod
    def of(cls, result: RuleResult) -> Self:
        """Return what became of a mutant by the rule's result."""
        if not result.findings:
            return cls(str(result.outcome), result.reason or "")
        causes = [dict(one.evidence or {}).get("cause") for one in result.findings]
        cause = next((one for one in causes if one), None) or {}
        named = tuple(cause.get("conventions", ()))
        return cls(str(result.outcome), result.findings[0].message, cause.get("convention"), cause.get("words"), named)

    @property
    def is_caught(self) -> bool:
        """Whether the rule failed."""
        return self.outcome == Outcome.FAIL


class Recorded:
    """Golden pairs of subjects, each recorded once.

    Args:
        folder: where they are kept.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def give(self, package: Path) -> None:
        """Put the pairs of a package's subject into it."""
        kept = self._folder / f"{package.name}.json"
        if not kept.is_file():
            with tempfile.TemporaryDirectory() as place:
                subject = Adapter(package.name).write(Path(place))
                record.record(load(subject), record.RecordOptions())
                shutil.copyfile(subject / names.PAIRS, kept)
        shutil.copyfile(kept, package / names.PAIRS)


def judged(package: Path, slug: str = PARITY, options: AuditOptions | None = None) -> RuleResult:
    """Return what one rule of the offline gate says of a package."""
    options = replace(options or AuditOptions(), gates=(Gate.OFFLINE,))
    (entry,) = (one for one in select((), (), (Gate.OFFLINE,)) if one.slug == slug)
    given = {"path": package, "kind": "policy", "gate": Gate.OFFLINE, "options": options}
    with Facts(given, providers.all_providers()) as facts:
        checks = Checks(facts)
        facts.add("checks", checks)
        return checks.result(entry)


def tried(mutant: Mutant, recorded: Recorded) -> Trial:
    """Plant a mutant and return what the parity rule says of it."""
    with tempfile.TemporaryDirectory() as place:
        package = mutant.write(Path(place))
        recorded.give(package)
        return Trial.of(judged(package))


def main() -> None:
    """Try the mutants that are named, or all, and print what was caught and named right, by who planted them."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("names", nargs="*", help="mutants or adapters")
    parser.add_argument("--source", action="append", choices=SOURCES, help="a file of mistakes; all by default")
    parser.add_argument("--json", type=Path, help="file for the table")
    asked = parser.parse_args()
    tally: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    table = []
    with tempfile.TemporaryDirectory() as place:
        recorded = Recorded(Path(place))
        for mutant in (one for source in asked.source or SOURCES for one in read(source)):
            if asked.names and not {mutant.name, mutant.adapter.name} & set(asked.names):
                continue
            started = time.monotonic()
            trial = tried(mutant, recorded)
            is_right = mutant.is_named(trial.conventions)
            tally[mutant.source].update(["planted", *["caught"] * trial.is_caught, *["named"] * is_right])
            table.append({"adapter": mutant.adapter.name, "name": mutant.name, "planted": mutant.conventions})
            table[-1].update(asdict(trial), right=is_right)
            mark = "named " if is_right else "CAUGHT" if trial.is_caught else "ESCAPED"
            told = f"{trial.convention}: {trial.words}" if trial.convention else trial.message
            _say(f"{mark} {time.monotonic() - started:5.1f} s  {mutant.adapter.name:22} {mutant.name:40} {told}")
    for source, counts in tally.items():
        _say(f"{source}: {counts['planted']} planted, {counts['caught']} red, {counts['named']} with the right cause")
    if asked.json is not None:
        asked.json.write_text(json.dumps(table, indent=1) + "\n")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
