"""What a verdict depends on besides results: the options, and what the package itself leaves open."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.gates import GATES
from xpl_cli.audit.rules.model import Circumstances, NotRun
from xpl_cli.audit.static import file_reading
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.phrases import join_limited
from xpl_cli.basics.untrusted import command
from xpl_cli.model_io import names
from xpl_cli.packages.package import ENV
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.static.source import Source

_MOST = 3


def circumstances(source: Source, kind: str, options: AuditOptions, display_path: str) -> Circumstances:
    """Return what the verdict on a package depends on besides results.

    Args:
        source: its files.
        kind: `policy` or `env`.
        options: the options of the audit.
        display_path: the folder, as commands name it.
    """
    settings = () if kind == ENV else tuple(options.overrides)
    return replace(
        package_circumstances(source, kind, display_path), narrowed=describe_narrowing(kind, options), settings=settings
    )


def package_circumstances(source: Source, kind: str, display_path: str) -> Circumstances:
    """Return the part that follows from the package alone."""
    if kind == ENV:
        return Circumstances(placeholders=tuple(placeholders(source)))
    return Circumstances(
        placeholders=tuple(placeholders(source)),
        unknown=tuple(unknown_values(source)),
        assumed=tuple(one.where for one in source.manifest.assumed),
        without_pairs=why_without_pairs(source, display_path),
        is_unrecorded=is_unrecorded(source),
    )


def describe_narrowing(kind: str, options: AuditOptions) -> str:
    """Return what an audit leaves out, in a few words, or an empty string."""
    return ", ".join(_narrowing_parts(kind, options))


def placeholders(source: Source) -> Iterator[str]:
    """Yield every placeholder in the files directly in a package, as `FILE:LINE`."""
    marker = re.compile(rf"{re.escape(spec.data('package')['placeholder'])}:\s*\S")
    try:
        with os.scandir(source.path) as entries:
            names_found = sorted(
                entry.name for entry in entries if file_reading.is_text(entry.name) and entry.is_file()
            )
    except OSError:  # a rule of the static gate reports it
        return
    for name in names_found:
        try:
            text = source.text(name)
        except NotRun:
            continue
        if marker.search(text):
            yield from (f"{name}:{number}" for number, line in enumerate(text.split("\n"), 1) if marker.search(line))


def unknown_values(source: Source) -> Iterator[str]:
    """Yield the keys of unknown values of the model_io block, as `images[0].channels`."""
    model_io = source.manifest.model_io
    if model_io is not None:
        from xpl.convert.gaps import gaps  # which needs numpy

        yield from (gap.where for gap in gaps(model_io.data))


def why_without_pairs(source: Source, display_path: str) -> str | None:
    """Return why there are no golden pairs to compare the policy's conversions with, or None."""
    if source.variant is not None:
        return None if _is_recorded(source) else f"no golden pairs of the variant {source.variant}"
    if source.has(names.PAIRS):
        return None
    if is_unrecorded(source):
        return f"{names.CODE} was not recorded: {command(('xpl', 'model-io', 'record', display_path))}"
    return f"no {names.CODE}"


def is_unrecorded(source: Source) -> bool:
    """Return whether a package has a reference.py without golden pairs. A variant needs none."""
    return source.variant is None and source.has(names.CODE) and not source.has(names.PAIRS)


def _is_recorded(source: Source) -> bool:
    """Return whether golden pairs are of the variant; golden-parity reports an invalid file."""
    from xpl_cli.model_io import pairs  # which needs numpy

    try:
        return source.has(names.PAIRS) and pairs.read(source.path).variant == source.variant
    except UserError:
        return True


def _narrowing_parts(kind: str, options: AuditOptions) -> Iterator[str]:
    """Yield each thing that an audit leaves out, in a few words."""
    selected_gates = [gate.value for gate in GATES[kind] if gate in options.gates]
    if len(selected_gates) < len(GATES[kind]):
        yield f"{' and '.join(selected_gates) or 'no gate'} only"
    if options.names:
        yield f"only {join_limited(options.names, _MOST)}"
    if options.ignore:
        yield f"without {join_limited(options.ignore, _MOST)}"
    if kind == ENV and options.overrides:
        yield f"only with --set {join_limited(tuple(options.overrides), _MOST)}"
