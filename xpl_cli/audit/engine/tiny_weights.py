"""Tiny random weights for an audit where the checkpoint lacks: made by the package's tiny.py, with golden pairs.

They are kept in the user's cache and used again as long as the package, its configuration and its interpreter are the
same.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl.checkpoint import CheckpointError, resolve
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.basics import parallel, user_cache
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.phrases import join_limited
from xpl_cli.lifecycle import interpreter
from xpl_cli.model_io import names, pairs, provenance, record, tiny, tiny_checkpoint
from xpl_cli.packages import package as packages
from xpl_cli.packages.package import POLICY

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.rules.model import TargetReport
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.static.source import Source
    from xpl_cli.packages.package import Package

_FORMAT: Final = 1
_FOLDER: Final = "tiny"
_MOST: Final = 3
_MOST_AHEAD: Final = 4


def provide(report: TargetReport, source: Source, options: AuditOptions) -> AuditOptions:
    """Return the options with a tiny checkpoint if the configured one lacks, and note tiny weights in the report.

    Nothing changes where tiny.py cannot be run here: the gates then say what the machine lacks.

    Args:
        report: of the package; gets circumstances.
        source: its files.
        options: of the audit.
    """
    if report.kind != POLICY or options.profile is Profile.SHADOW:
        return options
    try:
        package = packages.load(source.path, options.overrides)
        config = package.config(options.overrides)
        if _lacks(package, config):
            folder = _made(package, source, options)
            options = replace(options, overrides={**options.overrides, sdk.Deploy.CKPT_NAME: str(folder)})
            config = package.config(options.overrides)
        checkpoint = tiny_checkpoint.find(config, package.path)
        if checkpoint is None:
            return options
    except UserError as error:
        options.progress.step(f"{source.path.name}: {error}")
        return options
    options = replace(options, servers_ahead=min(parallel.cores(), _MOST_AHEAD))
    try:
        _record_pairs(package, checkpoint, options)
    except UserError as error:  # the weights are tiny all the same
        options.progress.step(f"{source.path.name}: {error}")
    has_pairs = (checkpoint / names.PAIRS).is_file()
    report.circumstances = replace(
        report.circumstances,
        weights=_describe(checkpoint),
        without_pairs=None if has_pairs else report.circumstances.without_pairs,
        is_unrecorded=report.circumstances.is_unrecorded and not has_pairs,
    )
    return options


def _lacks(package: Package, config: dict[str, object]) -> bool:
    """Tell whether the checkpoint of a package with tiny.py is not there."""
    if not (package.path / tiny.CODE).is_file():
        return False
    try:
        resolve(config, package.path)
    except CheckpointError:
        return True
    return False


def _made(package: Package, source: Source, options: AuditOptions) -> Path:
    """Return the folder of the package's tiny checkpoint, made if it is not in the cache.

    Raises:
        UserError: it cannot be made here.
    """
    python = interpreter.resolve(package.path, package.manifest.environment, python=options.python, env=options.env)
    key = [_FORMAT, source.boundary_hash(), python, options.overrides]
    digest = hashlib.sha256(json.dumps(key, sort_keys=True, default=str).encode()).hexdigest()[:16]
    folder = user_cache.folder() / _FOLDER / f"{package.name}-{digest}"
    if not (folder / tiny_checkpoint.RECORD).is_file():
        options.progress.step(f"{package.name}: no checkpoint is here; {tiny.CODE} makes one with random weights")
        folder.parent.mkdir(parents=True, exist_ok=True)
        tiny.make(
            package,
            folder,
            tiny.TinyOptions(options.overrides, python=options.python, env=options.env, progress=options.progress),
        )
    return folder


def _record_pairs(package: Package, checkpoint: Path, options: AuditOptions) -> None:
    """Record golden pairs of a tiny checkpoint, unless those that are there are of the same code.

    Raises:
        UserError: reference.py cannot be run.
    """
    if not (package.path / names.CODE).is_file():
        return
    try:
        recorded = pairs.read(checkpoint)
        python = interpreter.resolve(package.path, package.manifest.environment, python=options.python, env=options.env)
        if not provenance.code_problems(package.path, recorded.provenance, python):
            return
    except UserError:  # there are none, or they are of another version
        pass
    record.record(
        package, record.RecordOptions(options.overrides, options.python, options.env, progress=options.progress)
    )


def _describe(checkpoint: Path) -> str:
    """Return what a verdict says of the weights, with the inputs that they ignore."""
    unmoved = tiny_checkpoint.read(checkpoint).get("unmoved") or {}
    return f"{tiny_checkpoint.WORDS}{f', which ignore {join_limited(list(unmoved), _MOST)}' if unmoved else ''}"
