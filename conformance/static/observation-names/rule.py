"""XPL171: The adapter reads an observation by the names of the standard."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, OBSERVING, Adapter
from xpl_cli.audit.static.edits import replaced, same_quotes
from xpl_cli.audit.static.keys import entries, is_number, near
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant, texts
from xpl_cli.standard import spec


@rule(code="XPL171", requirement="XPL-OBS-1")
def observation_names(source: Source) -> Iterator[Finding]:
    """The adapter looks for an input under a name that observations do not have.

    ## What it does
    Follows in what the observing and acting methods reach which entries below `vision` and `state` they read, and
    compares the last name with the observation schema. Names that resemble one of it, or are another spelling of it in
    the field, are reported unless the function knows the right name too. Other names may belong to one environment
    and are left alone.

    ## Why it matters
    A look-up by the name that trajectories have raises in every environment of the standard; with `.get` the policy
    goes on without the value, and nobody is told.

    ## Example
    `obs["vision"]["cam_head"]["colors"]`, which is what a recording is called.

    ## Use instead
    `xpl.observation.get_image(obs, "cam_head")`, `xpl.observation.pack_state`, or the names that
    `xpl spec show observation` lists.

    ## Fix safety
    The name that the standard has, in place of the one that it does not have.
    """
    known = _names()
    spellings = {other: name for name, others in spec.data("conventions")["readers"].items() for other in others}
    for function in Adapter.of(source).reach(*OBSERVING, *ACTING):
        for entry in entries(function):
            names = known.get(entry.group, ())
            other = spellings.get(entry.name)
            right = other if other in names and entry.name not in names else near(entry.name, names)
            if right is None or right in texts(function.node):
                continue
            edits: tuple[Edit, ...] = ()
            if constant(entry.key) == entry.name and (right == other or is_number(entry.name, right)):
                text = same_quotes(source, function.file, entry.key, right)
                edits = (replaced(source, function.file, entry.key, text),)
            what = "every step ends with a KeyError" if entry.required else "the policy never gets it, in silence"
            yield Finding(
                f"observations have {right} and not {entry.name} below {entry.group}: {what}",
                **source.at(function.file, entry.key),
                expected=right,
                got=entry.name,
                fix=Fix("safe_edit" if edits else "advice", f"{right} in place of {entry.name}", edits),
            )


def _names() -> dict[str, tuple[str, ...]]:
    """Return the leaves of an observation by their group."""
    camera = tuple(value for key, value in vars(sdk.Camera).items() if key.isupper())
    bare = [value for key, value in vars(sdk.State).items() if key.isupper()]
    prefixes = dict.fromkeys(prefix for given in sdk.ARM_PREFIXES.values() for prefix in given)
    return {sdk.Obs.VISION: camera, sdk.Obs.STATE: tuple(prefix + name for prefix in prefixes for name in bare)}
