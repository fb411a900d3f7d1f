"""XPL193: The block model_io has no unknown values."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl.convert.gaps import gaps
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.manifests import location_in
from xpl_cli.audit.static.source import Source

_FILE, _BLOCK = sdk.File.POLICY_YML, "model_io"


@rule(code="XPL193", requirement="XPL-NAT-2", after=("manifest",))
def model_io_unknown(source: Source) -> Iterator[Finding]:
    """The block model_io has values that are still unknown.

    ## What it does
    Counts the values of `model_io` in `policy.yml` that are `{unknown: why}`, and lists each with its key and reason,
    in one finding.

    ## Why it matters
    No check proves a convention that depends on an unknown value, and the policy does not start before it is set.
    Checks that do not need the value use a default in its place (`xpl audit --shadow`).

    ## Example
    `channels: {unknown: the checkpoint does not say whether training read images with OpenCV}`.

    ## Use instead
    Ask the authors, read their data loader, or compare both values with reference.py (`xpl model-io record`); then
    write the value: `channels: bgr`. A value that has to be chosen meanwhile is `{assumed: rgb, why: reason}`: the
    policy runs, and the verdict names it.

    ## Fix safety
    No automatic fix.
    """
    model_io = source.manifest.model_io
    if model_io is None:
        raise NotApplicable("policy.yml has no model_io block")
    unknown = gaps(model_io.data)
    if unknown:
        what = "a value" if len(unknown) == 1 else f"{len(unknown)} values"
        first, *rest = (f"{gap.where} ({gap.reason})" for gap in unknown)
        yield Finding(
            f"{what} of the model_io block unknown: {'; '.join((first, *rest))}",
            **location_in(source, _FILE, (_BLOCK, *unknown[0].path)),
            expected="a value in each place",
            got=f"{len(unknown)} times unknown",
            evidence={gap.where: gap.reason for gap in unknown},
            fix=Fix(
                "advice", "write the value of the authors' code, or {assumed: value, why: reason} to run without it"
            ),
        )
