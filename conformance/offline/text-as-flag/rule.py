"""XPL249: A setting stays on if the string "false" switches it off."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.configurations import Configurations, flags_of
from xpl_cli.audit.served.probe import blame

_FLAGS = (True, False)
_MOST = 4


@rule(code="XPL249", requirement="XPL-CFG-3", loads=True, tries="false and null as settings")
def text_as_flag(configurations: Configurations) -> Iterator[Finding]:
    """A setting stays on if the string "false" switches it off.

    ## What it does
    Serves the adapter with the string "false" in place of each of its own boolean keys of deploy.yml, and with the
    value itself. An error is a valid reaction to a string; the actions of `true` are not. At most four keys are tried:
    each takes up to three servers.

    ## Why it matters
    Launchers and shell scripts pass strings. The run does the opposite of what its log says.

    ## Example
    `if config["use_depth"]:`, where the string "false" is true like every non-empty string.

    ## Use instead
    `self.setting("use_depth", False)`, which refuses a string where a flag is expected.

    ## Fix safety
    No automatic fix.
    """
    settings = dict(flags_of(configurations.own_keys()))
    if not settings:
        raise NotApplicable("no key of deploy.yml is a boolean")
    configurations.require_repeats()
    judged: list[str] = []
    for key, value in list(settings.items())[:_MOST]:
        on, off = (configurations.changed(**{key: flag}) if flag != value else configurations.usual for flag in _FLAGS)
        text = configurations.changed(**{key: "false"})
        if text.refusal is not None or on.difference(off):
            judged.append(key)
        if text.refusal is None and on.difference(off) and text.difference(on) is None:
            yield blame(
                f'{key}: the string "false" acts as true: a launcher that passes strings does the opposite',
                expected="the actions of false, or an error",
                got=f"the actions of true: {off.difference(text)}",
                fix=Fix("advice", f'read it with self.setting("{key}", {value})'),
            )
    if not judged:
        raise NotApplicable("no boolean of deploy.yml changes the actions: which one a string acts as cannot be seen")
