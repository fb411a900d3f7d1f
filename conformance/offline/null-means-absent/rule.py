"""XPL250: A setting that is null is not treated like one that is left out."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.configurations import Configurations, EpisodeResult
from xpl_cli.audit.served.probe import blame

_MOST = 8


@rule(code="XPL250", requirement="XPL-CFG-6", loads=True, compares=True, tries="false and null as settings")
def null_means_absent(configurations: Configurations) -> Iterator[Finding]:
    """A setting that is null is not treated like one that is left out.

    ## What it does
    Serves the adapter without its own keys of deploy.yml, and with null in their place, and compares the episodes. If
    they differ, the first eight keys are tried one by one. Required keys are skipped.

    ## Why it matters
    null in deploy.yml means not set: the template and launchers write it for open settings. The default in the code
    then does not apply, and the model fails or acts differently.

    ## Example
    `config.get("horizon", 16)`, which is None if deploy.yml has `horizon: null`.

    ## Use instead
    `self.setting("horizon", 16)`.

    ## Fix safety
    No automatic fix.
    """
    keys = list(configurations.own_keys())
    configurations.require_repeats()
    together = configurations.without(keys)
    if together.refusal is None and together.difference(_null(configurations, keys)) is None:
        return
    compared, found = False, False
    for key in keys[:_MOST]:
        absent = configurations.without([key])
        compared = compared or absent.refusal is None
        mismatch = None if absent.refusal is not None else absent.difference(_null(configurations, [key]))
        if mismatch is not None:
            found = True
            yield blame(
                f"{key}: null is not treated as missing: the default in the code does not apply",
                expected="what the adapter does without the key",
                got=mismatch,
                fix=Fix("advice", f'read it with self.setting("{key}", default)'),
            )
    if not compared and not found:
        raise NotApplicable("without any one of its keys of deploy.yml the policy is not served")


def _null(configurations: Configurations, keys: list[str]) -> EpisodeResult:
    return configurations.changed(**dict.fromkeys(keys))
