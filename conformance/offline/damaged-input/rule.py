"""XPL235: A required input that is damaged is passed on to the model."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.faulty import damaged, judge
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.inputs import present
from xpl_cli.audit.served.probe import Probe


@rule(code="XPL235", requirement="XPL-OBS-8")
def damaged_input(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A required input that is damaged is passed on to the model.

    ## What it does
    Damages each input that the manifest requires, one at a time. States: NaN, infinity, text, one value too many or too
    few, another axis. Pictures: floats from 0 to 1, no channels, channels first, a fourth channel. The instruction: a
    number. The answer must be an error that names the input. Inputs that have no effect at all are left to
    `inputs-matter`.

    ## Why it matters
    A network answers anything. A state that is one joint short, or a picture that was scaled twice, gives motion that
    looks like that of a bad policy; an encoder that fails in flight gives NaN, and NaN may become any motion.

    ## Example
    `np.asarray(obs["state"]["arm_joint_state"], np.float32)`, which also takes NaN, text and another length.

    ## Use instead
    `xpl.observation.pack_state` and `get_image`, which say what is wrong with which input.

    ## Fix safety
    No automatic fix.
    """
    names = probe.named_inputs()
    probe.ready()
    obs = probe.observation()
    judged = (set(names) & set(present(obs))) - semantics.evidently_unseen()
    with probe.session() as policy:
        yield from judge(
            policy,
            (case for name in names if name in judged for case in damaged(obs, name)),
            goes_on="{name} is taken as it comes ({faults}): the policy acts on it instead of stopping",
            unclear="{name} is refused ({faults}), but the error does not say that {name} is the cause",
            fix=Fix("advice", "read states with xpl.observation.pack_state and pictures with get_image"),
        )
