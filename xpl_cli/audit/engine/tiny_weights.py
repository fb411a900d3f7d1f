"""Tiny random weights for an audit where the checkpoint lacks: made by a recipe, with golden pairs.

They are kept in the user's cache and used again as long as the package, its configuration and its interpreter are the
same.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from xpl.checkpoint import CUDA_ON_CPU, CheckpointError, resolve
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.basics import parallel, user_cache
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.phrases import join_limited
from xpl_cli.lifecycle import interpreter
from xpl_cli.model_io import names, pairs, provenance, recipes, record, tiny, tiny_checkpoint
from xpl_cli.packages import package as packages
from xpl_cli.packages.package import POLICY

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.rules.model import TargetReport
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.static.source import Source
    from xpl_cli.model_io.recipes import Recipe
    from xpl_cli.packages.package import Package

_FORMAT: Final = 1
_FOLDER: Final = "tiny"
_MOST: Final = 3
_MOST_AHEAD: Final = 4


def provide(report: TargetReport, source: Source, options: AuditOptions) -> AuditOptions:
    """Return the options with a tiny checkpoint if the configured one lacks, and note tiny weights in the report.

    Nothing changes where the recipe cannot be run here: the gates then say what the machine lacks.

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
        recipe = recipes.find(package)
        if recipe is not None and _lacks(recipe, package, config):
            folder = _made(recipe, package, source, options)
            options = replace(options, overrides=recipe.overrides(folder, options.overrides))
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


def _lacks(recipe: Recipe, package: Package, config: dict[str, object]) -> bool:
    """Tell whether the checkpoint of a package with a recipe is not there."""
    if recipe.is_foreign:
        return not recipe.is_configured(config, package.path)
    try:
        resolve(config, package.path)
    except CheckpointError:
        return True
    return False


def _made(recipe: Recipe, package: Package, source: Source, options: AuditOptions) -> Path:
    """Return the folder of a package's tiny checkpoint, made if it is not in the cache.

    Raises:
        UserError: it cannot be made here.
    """
    python = interpreter.resolve(package.path, package.manifest.environment, python=options.python, env=options.env)
    key = [_FORMAT, source.boundary_hash(), python, options.overrides]
    if recipe.is_foreign:
        key.append(hashlib.sha256(recipe.path.read_bytes()).hexdigest())
    digest = hashlib.sha256(json.dumps(key, sort_keys=True, default=str).encode()).hexdigest()[:16]
    folder = user_cache.folder() / _FOLDER / f"{package.name}-{digest}"
    if not (folder / tiny_checkpoint.RECORD).is_file():
        options.progress.step(
            f"{package.name}: no checkpoint is here; {recipe.path.name} makes one with random weights"
        )
        folder.parent.mkdir(parents=True, exist_ok=True)
        tiny.make(
            package,
            folder,
            tiny.TinyOptions(
                options.overrides,
                python=options.python,
                env=options.env,
                progress=options.progress,
                may_fail=recipe.is_foreign,
            ),
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
    made = tiny_checkpoint.read(checkpoint)
    unmoved = made.get("unmoved") or {}
    ignored = f", which ignore {join_limited(list(unmoved), _MOST)}" if unmoved else ""
    return f"{tiny_checkpoint.WORDS}{ignored}{', cuda means the CPU' if made.get(CUDA_ON_CPU) else ''}"
