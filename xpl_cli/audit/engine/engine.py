"""Run the gates on packages: every rule of a gate, and the next gate only if this one has no failure.

The static gate of many packages runs in parallel processes. The gates that serve an adapter run one after the other:
they measure time, and one adapter may use a whole machine.
"""

from __future__ import annotations

import gc
import hashlib
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.audit.engine import providers
from xpl_cli.audit.engine.cache import PassCache
from xpl_cli.audit.engine.checks import Checks, describe_crash
from xpl_cli.audit.engine.circumstances import circumstances, describe_narrowing
from xpl_cli.audit.engine.waivers import waive
from xpl_cli.audit.offline.demonstrations import declaration
from xpl_cli.audit.rules.facts import Facts
from xpl_cli.audit.rules.fingerprint import fingerprint
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, NotRun, Outcome, RuleResult, TargetReport
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.rules.registry import OUR_CODES, RegistryError, RuleEntry, find, select
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.progress import Progress
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages.package import ENV

if TYPE_CHECKING:
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.packages.targets import AuditTarget


def audit(path: Path, kind: str, options: AuditOptions, *, display_path: str | None = None) -> TargetReport:
    """Audit one package.

    Args:
        path: its folder.
        kind: `policy` or `env`.
        options: what to run.
        display_path: how reports name the folder; the path itself by default.

    Raises:
        UserError: it has no such variant as the options ask for.
    """
    source = Source(path, options.variant)
    if options.variant is not None:
        try:
            _ = source.manifest
        except NotRun as error:
            raise UserError(f"{path.name}: {error}") from None
    report = TargetReport(path=display_path or str(path), name=path.name, kind=kind)
    report.circumstances = circumstances(source, kind, options, report.path)
    _run_gates(report, path, options, source)
    return report


def audit_all(targets: Sequence[AuditTarget], options: AuditOptions) -> list[TargetReport]:
    """Audit several packages; the reports are in the order of the packages."""
    if len(targets) < 2 or Gate.STATIC not in options.gates:
        return [audit(target.path, target.kind, options, display_path=target.shown) for target in targets]
    from xpl_cli.basics.parallel import map_in_processes

    select(options.names, options.ignore, options.gates)  # a wrong name is the user's error, not a package's
    reports = []
    static = replace(options, gates=(Gate.STATIC,), progress=Progress())
    later = replace(options, gates=tuple(gate for gate in options.gates if gate is not Gate.STATIC))
    options.progress.step(f"{len(targets)} packages: static gate")
    for target, report in zip(
        targets, map_in_processes(_audit_static, [(target, static) for target in targets]), strict=True
    ):
        options.progress.detail(f"{target.path.name}: static gate done")
        reports.append(report or _crash_report(target))
    for target, report in zip(targets, reports, strict=True):
        _run_gates(report, target.path, later)
        report.circumstances = replace(report.circumstances, narrowed=describe_narrowing(target.kind, options))
    return reports


def _audit_static(task: tuple[AuditTarget, AuditOptions]) -> TargetReport:
    """Audit one of many packages; an error in one does not affect the others."""
    target, options = task
    try:
        return audit(target.path, target.kind, options, display_path=target.shown)
    except RegistryError:
        raise
    except Exception as error:  # noqa: BLE001 - the other packages are still audited
        return _crash_report(target, f"{describe_crash(error)}; xpl audit of this package alone shows more")


def _crash_report(
    target: AuditTarget,
    reason: str = "the process that read the package died; xpl audit of this package alone shows how",
) -> TargetReport:
    """Return the report on a package whose process died, for example of memory."""
    rule = find("parses")
    result = RuleResult(rule.code, rule.slug, rule.requirement, rule.severity, Outcome.ERROR, reason=reason)
    gate = GateReport(name=Gate.STATIC, results=[result])
    return TargetReport(path=target.shown, name=target.path.name, kind=target.kind, gates=[gate])


def _run_gates(report: TargetReport, path: Path, options: AuditOptions, source: Source | None = None) -> None:
    """Run the requested gates on a package, after those that its report already has.

    Args:
        report: gets the gates' reports.
        path: the folder of the package.
        options: what to run.
        source: the package, already read; the static gate reads no file of it again.
    """
    options = replace(options, time_limit=options.time_limit.started())
    serving: AuditOptions | None = None
    chosen = [entry for entry in select(options.names, options.ignore, options.gates) if entry.target == report.kind]
    if not (options.names or options.demos or declaration.exists(path)):
        chosen = [entry for entry in chosen if not entry.needs_demonstrations]
    for gate in options.gates:
        selected = [entry for entry in chosen if entry.runs_in(gate)]
        if not any(not entry.closes or gate is Gate.STATIC for entry in selected):
            continue
        blocked = None if options.keep_going else _blocker(report)
        if blocked is None and report.kind == ENV and gate is not Gate.STATIC:
            blocked = _why_not_moved(path, selected, options)
        if blocked is not None:
            waiting = [entry for entry in selected if not entry.closes]
            report.gates.append(_not_started(gate, waiting, blocked))
            continue
        options.progress.step(f"{path.name}: {gate} gate, {len(selected)} rules")
        if gate is Gate.STATIC:
            with _garbage_collector_disabled():
                _run_gate(gate, selected, source or Source(path, options.variant), report, options)
        else:
            if serving is None:
                from xpl_cli.audit.engine.tiny_weights import provide  # which needs numpy

                serving = provide(report, Source(path, options.variant), options)
            bounds = IsolationSettings.strictest(path.parent, isolate=options.isolate)
            _run_gate(gate, selected, Source(path, options.variant), report, replace(serving, bounds=bounds))


def _run_gate(
    gate: Gate, selected: list[RuleEntry], source: Source, target: TargetReport, options: AuditOptions
) -> None:
    """Run a gate and add its report."""
    started = time.perf_counter()
    path = source.path
    report = GateReport(name=gate, source=None if gate is Gate.STATIC else source.record())
    target.gates.append(report)
    is_cacheable = gate is Gate.STATIC and options.variant is None  # the cache is of the policy itself
    passes = PassCache.of(options.cache, path) if options.cache is not None and is_cacheable else None
    initial_facts = {"path": path, "kind": target.kind, "gate": gate, "options": _with_earlier_profile(target, options)}
    with Facts(initial_facts, providers.all_providers()) as facts:
        checks = Checks(facts, passes)
        facts.add("checks", checks)
        facts.add("source", source)
        waivers = facts.get("waivers") if target.kind == "policy" else ()
        records: list[str] | None = None
        for entry in sorted(selected, key=lambda entry: (entry.closes, entry.source is not None)):
            if records is None and entry.source is not None:
                records = facts.records()  # before rules of installed packages, which other users may lack
            if (
                entry.closes
                and gate is not Gate.STATIC
                and not any(_may_run_in(waiver.entry, gate) for waiver in waivers)
            ):
                continue
            options.progress.detail(f"{path.name}: {gate} gate, {entry.code} {entry.slug}")
            result = checks.result(entry)
            report.results.append(result if entry.closes else waive(result, waivers))
        if gate is Gate.STATIC:
            _note_contents(target, report, source)
        probe = facts.computed("probe")
        report.served = probe.served if probe is not None else None
        simulation = facts.computed("simulation")
        report.measurements = tuple(simulation.measurements) if simulation is not None else ()
        if gate is Gate.STATIC:  # which reads the files anyway, unless they are unchanged
            report.source = (passes.record if passes is not None else "") or source.boundary_hash()
        if gate is Gate.STATIC:
            records = [f"source {report.source}"]
        elif records is None:
            records = facts.records()
        report.digest = _digest(report, records)
        if passes is not None:
            passes.save(source)
    report.results.sort(key=lambda result: result.code)
    report.fingerprint = fingerprint(gate, "" if report.served is None else report.served.mark)
    report.seconds = time.perf_counter() - started


def _with_earlier_profile(target: TargetReport, options: AuditOptions) -> AuditOptions:
    """Return the options with the profile of an earlier gate: what was missing there is still missing."""
    for gate in target.gates:
        if gate.served is not None and gate.profile is Profile.SHADOW and options.profile is None:
            return replace(options, profile=Profile.SHADOW, profile_reason=gate.served.reason)
    return options


@contextmanager
def _garbage_collector_disabled() -> Iterator[None]:
    """Disable the garbage collector: it would traverse all syntax trees repeatedly and free none."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _may_run_in(entry: RuleEntry | None, gate: Gate) -> bool:
    return entry is not None and gate in entry.gates


def _note_contents(target: TargetReport, report: GateReport, source: Source) -> None:
    """Store the content of files that fixes would edit, so that no fix is applied to other content."""
    for result in report.results:
        for finding in result.findings:
            for edit in finding.fix.edits if finding.fix is not None else ():
                target.contents[edit.path] = source.text(edit.path)


def _digest(report: GateReport, records: list[str]) -> str:
    """Return a hash of the outcomes and of the adapter's behaviour, as the gate's facts recorded it.

    Rules of installed packages are left out, since other users may lack them.
    """
    counted = [result for result in report.results if result.code.startswith(OUR_CODES)]
    lines = [f"{result.code} {result.outcome} {len(result.findings)}" for result in counted]
    return hashlib.sha256("\n".join([*lines, *records]).encode()).hexdigest()[:16]


def _why_not_moved(path: Path, selected: Sequence[RuleEntry], options: AuditOptions) -> str | None:
    """Return why an environment may not run, with a dry run of its motions; None if it may."""
    from xpl_cli.audit.environments.dry_run import dry_run_report  # which needs numpy
    from xpl_cli.packages.manifests import ManifestError

    try:
        return dry_run_report(path, [entry for entry in selected if not entry.closes], options)
    except ManifestError:  # its rules report it
        return None


def _blocker(report: TargetReport) -> str | None:
    for gate in report.gates:
        if gate.outcome in (Outcome.FAIL, Outcome.ERROR, Outcome.NOT_RUN):
            return f"the {gate.name} gate did not pass"
    return None


def _not_started(gate: Gate, selected: list[RuleEntry], reason: str) -> GateReport:
    rules = [entry.load() for entry in selected]
    results = [
        RuleResult(item.code, item.slug, item.requirement, item.severity, Outcome.NOT_RUN, reason=reason)
        for item in rules
    ]
    return GateReport(name=gate, results=results, reason=reason)
