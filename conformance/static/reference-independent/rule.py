"""XPL194: reference.py uses no code of the adapter."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.independence import adapter_uses
from xpl_cli.audit.static.source import Source
from xpl_cli.model_io import names


@rule(code="XPL194", requirement="XPL-NAT-4", after=("parses",))
def reference_independent(source: Source) -> Iterator[Finding]:
    """reference.py uses the adapter's own conversions, so comparing the two proves nothing.

    ## What it does
    Reads reference.py, and the files of the package that it imports: none of them may import `xpl` or the adapter's
    model.py, or mention policy.yml. `xpl model-io record` also checks which modules were actually imported.

    ## Why it matters
    Parity compares the adapter with the authors' own pre- and post-processing. If both run the same code, a mistake in
    a convention is in both, and every comparison passes.

    ## Example
    `from .model import Model` in reference.py, or `yaml.safe_load(open("policy.yml"))["model_io"]`.

    ## Use instead
    The authors' classes and transforms: `from their_package.policy import Policy`. Code of the network itself, without
    conversions, may be shared in a file of its own, such as network.py. Settings come in `config`.

    ## Fix safety
    No automatic fix.
    """
    if not source.has(names.CODE):
        raise NotApplicable(f"there is no {names.CODE}: there is no reference for the model")
    source.tree(names.CODE)
    for use in adapter_uses(source):
        yield Finding(
            f"{names.CODE} is not independent: {use.location['path']} {use.by} the adapter's own {use.what}",
            **use.location,
            expected="the authors' code, and the configuration that answers(config) gets",
            got=use.what,
            fix=Fix("advice", "use the authors' classes and transforms instead"),
        )
