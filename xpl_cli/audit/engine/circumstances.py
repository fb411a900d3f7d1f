"""What a verdict depends on besides results: what was asked for, and what the package itself leaves open."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.gates import GATES
from xpl_cli.audit.rules.model import Circumstances, NotRun
from xpl_cli.audit.static import reading
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.untrusted import command
from xpl_cli.basics.words import listed
from xpl_cli.model_io import names
from xpl_cli.packages.package import ENV
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.rules.options import Options
    from xpl_cli.audit.static.source import Source

_MOST = 3


def circumstances(source: Source, kind: str, options: Options, shown: str) -> Circumstances:
    """Return what the verdict on a package depends on besides results.

    Args:
        source: its files.
        kind: `policy` or `env`.
        options: what was asked for.
        shown: how commands name the folder.
    """
    settings = () if kind == ENV else tuple(options.overrides)
    return replace(of_package(source, kind, shown), narrowed=narrowed(kind, options), settings=settings)


def of_package(source: Source, kind: str, shown: str) -> Circumstances:
    """Return what of it the package itself says."""
    if kind == ENV:
        return Circumstances(places=tuple(places(source)))
    return Circumstances(
        places=tuple(places(source)),
        unknown=tuple(unknown(source)),
        assumed=tuple(one.where for one in source.manifest.assumed),
        without_pairs=without_pairs(source, shown),
        is_unrecorded=is_unrecorded(source),
    )


def narrowed(kind: str, options: Options) -> str:
    """Return what an audit leaves out, in a few words; empty if nothing."""
    return ", ".join(_narrowed(kind, options))


def places(source: Source) -> Iterator[str]:
    """Yield every place directly in a package that is marked for its author, `FILE:LINE`."""
    marker = re.compile(rf"{re.escape(spec.data('package')['placeholder'])}:\s*\S")
    try:
        with os.scandir(source.path) as entries:
            found = sorted(entry.name for entry in entries if reading.is_text(entry.name) and entry.is_file())
    except OSError:  # which a rule of the static gate tells
        return
    for name in found:
        try:
            text = source.text(name)
        except NotRun:
            continue
        if marker.search(text):
            yield from (f"{name}:{place}" for place, line in enumerate(text.split("\n"), 1) if marker.search(line))


def unknown(source: Source) -> Iterator[str]:
    """Yield every value of the model_io block that its author says is unknown, as `images[0].channels`."""
    model_io = source.manifest.model_io
    if model_io is not None:
        from xpl.convert.gaps import gaps  # which needs numpy

        yield from (gap.where for gap in gaps(model_io.data))


def without_pairs(source: Source, shown: str) -> str | None:
    """Return why a policy's conversions cannot be compared with the model's own, None if there are golden pairs."""
    if source.variant is not None:
        return None if _is_recorded(source) else f"no golden pairs of the variant {source.variant}"
    if source.has(names.PAIRS):
        return None
    if is_unrecorded(source):
        return f"{names.CODE} was not recorded: {command(('xpl', 'model-io', 'record', shown))}"
    return f"no {names.CODE}"


def is_unrecorded(source: Source) -> bool:
    """Tell whether a package has a reference.py that nobody recorded. Of a variant golden-parity asks for no pairs."""
    return source.variant is None and source.has(names.CODE) and not source.has(names.PAIRS)


def _is_recorded(source: Source) -> bool:
    """Tell whether golden pairs are of the variant; of a file that is none, golden-parity tells."""
    from xpl_cli.model_io import pairs  # which needs numpy

    try:
        return source.has(names.PAIRS) and pairs.read(source.path).variant == source.variant
    except UserError:
        return True


def _narrowed(kind: str, options: Options) -> Iterator[str]:
    """Yield what an audit leaves out, in a few words."""
    asked = [gate.value for gate in GATES[kind] if gate in options.gates]
    if len(asked) < len(GATES[kind]):
        yield f"{' and '.join(asked) or 'no gate'} only"
    if options.names:
        yield f"only {listed(options.names, _MOST)}"
    if options.ignore:
        yield f"without {listed(options.ignore, _MOST)}"
    if kind == ENV and options.overrides:
        yield f"only with --set {listed(tuple(options.overrides), _MOST)}"
