"""The pages of all rules, written from the rules themselves; a test writes them again and compares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from xpl_cli.audit.rules.registry import Rule, rules
from xpl_cli.derived.reference import NOTE, prose, table
from xpl_cli.standard import spec

FOLDER = "docs/rules"
"""Where the pages are, in a checkout."""

_PAGES: Final = {
    "1": ("static", "Static gate", "Rules that read an adapter's files, and neither import nor run anything of it."),
    "2": ("offline", "Offline gate", "Rules that serve an adapter and play closed loops against it, without physics."),
    "3": ("mujoco", "MuJoCo gate", "Rules that drive an adapter in physics. They judge its interface, not its skill."),
    "4": ("environments", "Environments", "Rules about environment packages, of the static and the offline gate."),
    "5": ("audit", "The audit itself", "Rules that judge what an audit was told, in every gate."),
    "6": ("advice", "Advice", "What other tools say of an adapter's files; only where it is selected."),
}
"""The first digit of a code: name, title and introduction of its page."""

_INTRODUCTION = """\
What `xpl audit` checks. Severity comes from the requirement that a rule proves: a MUST that does not hold fails, a
SHOULD warns, and a dash stands where that version of the standard does not ask for it. `xpl explain CODE` prints an
entry.
"""


def pages() -> dict[str, str]:
    """Return every page, file name to text: an index, and a page for each hundred of codes."""
    found: dict[str, list[Rule]] = {digit: [] for digit in _PAGES}
    for rule in rules():
        found[rule.code.removeprefix("XPL")[0]].append(rule)
    written = {"README": _index(found)}
    for digit, members in found.items():
        name, title, introduction = _PAGES[digit]
        written[name] = "\n".join(
            [f"# {title}", "", introduction, *(line for rule in members for line in _entry(rule))]
        )
    return {f"{name}.md": f"{NOTE}\n{text.strip()}\n" for name, text in sorted(written.items())}


def _index(found: dict[str, list[Rule]]) -> str:
    lines = ["# Rules", "", _INTRODUCTION]
    for digit, members in found.items():
        name, title, _ = _PAGES[digit]
        rows = [
            (f"[{rule.code}]({name}.md#{rule.code.lower()}-{rule.slug}) {rule.slug}", *_severities(rule), rule.summary)
            for rule in members
        ]
        lines += [f"## {title}", "", *table(("rule", *spec.published(), "finds"), rows), ""]
    return "\n".join(lines)


def _severities(rule: Rule) -> Sequence[str]:
    return [rule.severity_in(version) if rule.is_in(version) else "-" for version in spec.published()]


def _entry(rule: Rule) -> Iterator[str]:
    """Yield the lines of one rule: what it proves, then its documentation with headings that are no anchors."""
    requirement = spec.requirement(rule.requirement)
    levels = ", ".join(f"{version} {told}" for version, told in zip(spec.published(), _severities(rule), strict=True))
    summary, *sections = rule.documentation.split("\n## ")
    yield from ("", f"## {rule.code} {rule.slug}", "", prose(summary), "")
    proves = f"proves [{requirement.id}](../reference/requirements.md)"
    yield f"*{rule.gate.value} gate; {levels}; {proves}:* {prose(requirement.text)}"
    for section in sections:
        heading, _, text = section.partition("\n")
        yield from ("", f"**{heading}**", "", *text.strip().splitlines())
