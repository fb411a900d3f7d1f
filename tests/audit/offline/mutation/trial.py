"""Plant mutants, run the offline gate on them rule by rule, and report the share that is caught.

    python -m tests.audit.offline.mutation.trial [NAME...] [--write]

`--write` notes which rule caught what in `caught_by.json`. The note only decides which rule is tried first; what a rule
catches that looks at what others did has none.
"""

from __future__ import annotations

import argparse
import collections
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.audit.offline.mutation.mutants import MUTANTS, Mutant
from xpl_cli.audit.engine import providers
from xpl_cli.audit.engine.checks import Checks
from xpl_cli.audit.rules.facts import Facts
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.registry import select

NOTES = Path(__file__).parent / "caught_by.json"
SUBJECT = "Subject"
_FOUND = (Outcome.FAIL, Outcome.WARN)


@dataclass(frozen=True)
class Trial:
    """What became of a mutant.

    Attributes:
        rule: slug of the first rule that found something, None if none did.
        message: what it said.
        crashed: slugs of rules that crashed before.
    """

    rule: str | None
    message: str = ""
    crashed: tuple[str, ...] = ()


def tried(mutant: Mutant, folder: Path) -> Trial:
    """Plant a mutant in a new folder below `folder` and run the offline gate until a rule finds something."""
    path = mutant.plant(folder / SUBJECT)
    likely = json.loads(NOTES.read_text()).get(mutant.name)
    rules = [entry for entry in select((), (), (Gate.OFFLINE,)) if entry.target == "policy" and not entry.closes]
    rules.sort(key=lambda entry: entry.slug != likely)
    given = {"path": path, "kind": "policy", "gate": Gate.OFFLINE, "options": AuditOptions(gates=(Gate.OFFLINE,))}
    crashed = []
    with Facts(given, providers.all_providers()) as facts:
        checks = Checks(facts)
        facts.add("checks", checks)
        for entry in rules:
            result = checks.result(entry)
            if result.outcome in _FOUND:
                return Trial(entry.slug, result.findings[0].message, tuple(crashed))
            if result.outcome is Outcome.ERROR:
                crashed.append(entry.slug)
    return Trial(None, crashed=tuple(crashed))


def main() -> None:
    """Try the mutants that are named, or all, and print what caught each and the share of each class."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("names", nargs="*", help="mutants or classes of defects")
    parser.add_argument("--write", action="store_true", help="note which rule caught what")
    asked = parser.parse_args()
    chosen = [mutant for mutant in MUTANTS if not asked.names or {mutant.name, mutant.group} & set(asked.names)]
    notes = json.loads(NOTES.read_text())
    tally: dict[str, collections.Counter[bool]] = collections.defaultdict(collections.Counter)
    for mutant in chosen:
        started = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            trial = tried(mutant, Path(folder))
        tally[mutant.group][trial.rule is not None] += 1
        told = f"{trial.rule}: {trial.message}" if trial.rule else "ESCAPED"
        _say(f"{mutant.group:14} {mutant.name:34} {time.monotonic() - started:5.1f} s  {told}")
        if asked.write and trial.rule:
            notes[mutant.name] = trial.rule
            NOTES.write_text(json.dumps(notes, indent=2, sort_keys=True) + "\n")
    _say("")
    for group, counts in tally.items():
        _say(f"{group:14} {counts[True]:3} of {counts.total():3}")
    caught = sum(counts[True] for counts in tally.values())
    _say(f"{'all':14} {caught:3} of {len(chosen):3} ({caught / len(chosen):.1%})")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
