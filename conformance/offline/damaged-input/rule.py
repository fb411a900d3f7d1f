"""XPL235: An invalid value of a required input is passed on to the model."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.faulty_inputs import damaged, judge
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.changed_inputs import present
from xpl_cli.audit.served.probe import Probe


@rule(code="XPL235", requirement="XPL-OBS-8", tries="missing and damaged inputs")
def damaged_input(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """An invalid value of a required input is passed on to the model.

    ## What it does
    Replaces each input that the manifest requires by invalid values, one at a time. States: NaN, infinity, text, one
    value too many or too few, another axis. Images: floats from 0 to 1, no channels, channels first, a fourth channel.
    The instruction: a number. The result must be an error that names the input. `inputs-matter` reports inputs that
    have no effect at all.

    ## Why it matters
    A network computes something from any input. A state that lacks one joint, or an image that was scaled twice, gives
    motion that looks like that of a bad policy; an encoder that fails during motion gives NaN, which may become any
    motion.

    ## Example
    `np.asarray(obs["state"]["arm_joint_state"], np.float32)`, which also accepts NaN, text and another length.

    ## Use instead
    `xpl.observation.pack_state` and `get_image`, whose errors name the input and what is wrong with it.

    ## Fix safety
    No automatic fix.
    """
    names = probe.named_inputs()
    probe.require_answer()
    obs = probe.observation()
    judged = (set(names) & set(present(obs))) - semantics.known_ignored_inputs()
    if not judged:
        raise NotApplicable("no required input changes the actions: an invalid value of one cannot reach them")
    with probe.session() as policy:
        yield from judge(
            policy,
            (case for name in names if name in judged for case in damaged(obs, name)),
            goes_on="an invalid {name} is accepted ({faults}): the policy acts on it instead of stopping",
            unclear="{name} is refused ({faults}), but the error does not say that {name} is the cause",
            fix=Fix("advice", "read states with xpl.observation.pack_state and images with get_image"),
        )
