"""XPL215: Only one spelling of the instruction is accepted."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl.contract import ObservationDict
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.compare import error_code
from xpl_cli.audit.served.probe import Probe, blame

_FIX = Fix("advice", "read it with xpl.observation.get_instruction(obs, required=True)")


@rule(code="XPL215", requirement="XPL-OBS-4", compares=True, tries="spellings of the instruction")
def instruction_forms(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """Only one spelling of the instruction is accepted.

    ## What it does
    Sends the same observation once with `instruction` and once with `instructions`, a list whose first entry is the
    same text. A string under `instructions`, and a list under `instruction`, do not conform to the standard: they must
    be understood or refused, not read as something else.

    ## Why it matters
    Both occur in practice. A policy that ignores one of them gets no instruction there, or stops.

    ## Example
    `prompt = obs["instruction"]`, or `prompt = obs["instructions"][0]`, which of a string takes the first letter.

    ## Use instead
    `xpl.observation.get_instruction(obs, required=True)`, which also raises an error if there is none.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    obs = probe.observation()
    text = obs[spec.Obs.INSTRUCTION]
    rest = {key: value for key, value in obs.items() if key != spec.Obs.INSTRUCTION}
    forms: dict[str, ObservationDict] = {
        "`instructions`": {**rest, spec.Obs.INSTRUCTIONS: [text, "an alternative wording"]},
        "a string under `instructions`": {**rest, spec.Obs.INSTRUCTIONS: text},
        "a list under `instruction`": {**rest, spec.Obs.INSTRUCTION: [text]},
    }
    main_form, *others = forms
    answers = dict(zip(forms, semantics.compare([((obs,), (form,)) for form in forms.values()]), strict=True))
    mismatch = semantics.disagreement(*answers[main_form])
    found = mismatch is not None
    if mismatch is not None:
        yield blame(
            f"an observation with {main_form} is not read like one with `instruction`: the policy stops, or "
            "follows another instruction",
            expected="the action for the first of the list",
            got=mismatch,
            fix=_FIX,
        )
    for form in others:
        plain, answer = answers[form]
        if error_code(answer) is None and (mismatch := semantics.disagreement(plain, answer)) is not None:
            found = True
            yield blame(
                f"{form} is read as another instruction: the policy follows one that the user did not give",
                expected="the action for the string, or an error",
                got=mismatch,
                fix=_FIX,
            )
    if not found:
        semantics.require_steady()
        if spec.Obs.INSTRUCTION in semantics.known_ignored_inputs():
            raise NotApplicable("the instruction does not change the actions: which spelling is read cannot be seen")
