"""`xpl rules` and `xpl explain`: list rules, and explain rules and conventions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from xpl_cli.commands.options import JSON

if TYPE_CHECKING:
    from xpl_cli.audit.demonstrations.check import DemonstrationCheck
    from xpl_cli.audit.rules.registry import Rule
    from xpl_cli.audit.rules.retired import Retired
    from xpl_cli.standard.spec import Requirement


def explain(
    names: list[str] = typer.Argument(
        ..., metavar="RULE...", help="Codes or slugs of rules, such as XPL101 XPL203; or a convention, such as gripper."
    ),
    as_json: bool = JSON,
) -> None:
    """Explain rules: what each checks, why, and what to do instead. For a retired rule: what replaces it.

    A convention of the model_io block is explained alone: its values, their names in libraries, usual mistakes.
    """
    from xpl_cli.audit.rules.retired import Retired
    from xpl_cli.basics import console

    if _explain_convention(names, as_json=as_json):
        return
    found_rules = list({rule.code: rule for rule in map(_find_rule, names)}.values())
    requirements = {
        rule.code: requirement for rule in found_rules if (requirement := _requirement_of(rule)) is not None
    }
    if as_json:
        documents = [_rule_as_json(rule, requirements.get(rule.code)) for rule in found_rules]
        following = list(dict.fromkeys(f"xpl spec show {requirement.id}" for requirement in requirements.values()))
        following += [
            f"xpl explain {code}" for rule in found_rules if isinstance(rule, Retired) for code in rule.proven_by
        ]
        if len(documents) == 1:
            console.answer("xpl.explain/1", documents[0], following)
        else:
            console.answer("xpl.explanations/1", {"rules": documents}, following)
        return
    from rich.markdown import Markdown

    for rule in found_rules:
        if isinstance(rule, Retired):
            console.rich(Markdown(f"# {rule.code} {rule.slug}\n\n*retired*\n\n{rule.documentation}"))
            continue
        requirement = requirements.get(rule.code)
        proves = "*demonstrations, `xpl data validate`*"
        if requirement is not None:
            proves = f"*{rule.gate} gate, proves {requirement.id} ({requirement.level}):* {requirement.text}"
        console.rich(Markdown(f"# {rule.code} {rule.slug}\n\n{proves}\n\n{rule.documentation}"))


def _explain_convention(names: list[str], *, as_json: bool) -> bool:
    """Explain a convention if the only name is one (without hyphens, unlike slugs), and return whether it is."""
    if len(names) != 1 or not names[0].islower() or "-" in names[0]:
        return False
    from xpl.catalogue.convention import conventions
    from xpl_cli.basics import console
    from xpl_cli.model_io import description

    one = next((one for one in conventions() if one.name == names[0]), None)
    if one is None:
        return False
    explained = description.describe(one)
    if as_json:
        console.answer("xpl.convention/1", explained.document(), ["xpl model-io sources POLICY"])
        return True
    from rich.markdown import Markdown

    console.rich(Markdown("\n".join(description.render_markdown(explained))))
    return True


def _find_rule(name: str) -> Rule | type[DemonstrationCheck] | Retired:
    """Return a rule, a check of demonstrations or a retired rule, by its code or slug."""
    from xpl.catalogue.convention import conventions
    from xpl_cli.audit.demonstrations.catalogue import lookup
    from xpl_cli.audit.rules import retired
    from xpl_cli.audit.rules.registry import find
    from xpl_cli.basics.errors import UnknownNameError, no_such

    try:
        return lookup(name) or retired.lookup(name) or find(name)
    except UnknownNameError as error:
        known = [*error.known, *(convention.name for convention in conventions())]
        raise no_such(f"there is no rule or convention {name!r}", name, known, listing="xpl rules") from None


def _requirement_of(rule: Rule | type[DemonstrationCheck] | Retired) -> Requirement | None:
    """Return the requirement of a rule; None for a check of demonstrations, and for a retired rule."""
    from xpl_cli.audit.rules.retired import Retired
    from xpl_cli.standard import spec

    return None if isinstance(rule, Retired) or not rule.requirement else spec.requirements()[rule.requirement]


def _rule_as_json(rule: Rule | type[DemonstrationCheck] | Retired, requirement: Requirement | None) -> dict[str, Any]:
    from xpl_cli.audit.rules.retired import Retired

    return {
        "code": rule.code,
        "slug": rule.slug,
        "retired": isinstance(rule, Retired),
        "gate": None if isinstance(rule, Retired) else rule.gate.value,
        "requirement": None
        if requirement is None
        else {"id": requirement.id, "level": requirement.level, "text": requirement.text},
        "severity": None if isinstance(rule, Retired) else rule.severity,
        "documentation": rule.documentation,
    }


def rules(as_json: bool = JSON) -> None:
    """List every rule with its code, gate, requirement and summary, including checks of demonstrations."""
    from xpl_cli.audit.demonstrations.catalogue import CHECKS
    from xpl_cli.audit.rules.gates import DEMONSTRATIONS
    from xpl_cli.audit.rules.registry import rules as all_rules
    from xpl_cli.basics import console

    listed_rules: list[Rule | type[DemonstrationCheck]] = [*all_rules(), *CHECKS]
    if as_json:
        entries = [
            {
                "code": rule.code,
                "slug": rule.slug,
                "gate": rule.gate.value,
                "target": rule.target,
                "requirement": rule.requirement or None,
                "severity": rule.severity,
                "summary": rule.summary,
            }
            for rule in listed_rules
        ]
        console.answer("xpl.rules/1", {"rules": entries}, [f"xpl explain {listed_rules[0].code}"])
        return
    width = max(len(rule.slug) for rule in listed_rules)
    by_gate: dict[str, list[str]] = {}
    for rule in listed_rules:
        line = f"  {rule.code}  {rule.slug:<{width}}  {rule.severity:<6}  {rule.summary}"
        of_environments = " of environments" if rule.target == "env" else ""
        heading = f"{rule.gate} gate{of_environments}" if rule.target != DEMONSTRATIONS else "xpl data validate"
        by_gate.setdefault(heading, []).append(line)
    blocks = ["\n".join([gate, *lines]) for gate, lines in by_gate.items()]
    console.data("\n\n".join([*blocks, f"next\n  xpl explain {listed_rules[0].code}"]))
