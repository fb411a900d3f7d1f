"""The pages of all rules, generated from the rules; a test compares them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.demonstrations.catalogue import CHECKS
from xpl_cli.audit.rules.registry import OUR_CODES, Rule, builtin_entries
from xpl_cli.audit.rules.retired import retired
from xpl_cli.derived.reference import NOTE, prose, table
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.audit.demonstrations.check import DemonstrationCheck

FOLDER = "docs/rules"
"""Folder of the pages in a checkout."""

_PAGES: Final = {
    "1": ("static", "Static gate", "Rules that read an adapter's files, and neither import nor run anything of it."),
    "2": ("offline", "Offline gate", "Rules that serve an adapter and play closed loops against it, without physics."),
    "3": ("mujoco", "MuJoCo gate", "Rules that drive an adapter in physics. They judge its interface, not its skill."),
    "4": ("environments", "Environments", "Rules about environment packages, of the static and the offline gate."),
    "5": ("audit", "The audit itself", "Rules that judge what an audit was told, in every gate."),
    "6": ("advice", "Advice", "What other tools say of an adapter's files; only where it is selected."),
}
"""The first digit of a code: name, title and introduction of its page."""
_CONTINUED: Final = {"7": "1"}
"""First digits whose codes continue those of another page, which are used up."""
_DATA: Final = (
    "demonstrations",
    "Demonstrations",
    "What `xpl data validate` checks in a set of recorded episodes. The standard asks for none of it.",
)

_INTRODUCTION = """\
What `xpl audit` checks. Severity comes from the requirement that a rule proves: a MUST that does not hold fails, a
SHOULD warns. `xpl explain CODE` prints an entry.
"""
_RETIRED: Final = "Their codes and names are not used again. A waiver that names one may be deleted."


def pages() -> dict[str, str]:
    """Return all pages by file name: an index, and a page per hundred codes."""
    found: dict[str, list[Rule]] = {digit: [] for digit in _PAGES}
    for rule in (entry.load() for entry in builtin_entries()):
        digit = rule.code.removeprefix(OUR_CODES)[0]
        found[_CONTINUED.get(digit, digit)].append(rule)
    written = {"README": _index(found)}
    for digit, members in found.items():
        name, title, introduction = _PAGES[digit]
        written[name] = "\n".join(
            [f"# {title}", "", introduction, *(line for rule in members for line in _entry(rule))]
        )
    name, title, introduction = _DATA
    lines = (line for check in CHECKS for line in _described(check, f"*`xpl data validate`; {check.severity}*"))
    written[name] = "\n".join([f"# {title}", "", introduction, *lines])
    return {f"{name}.md": f"{NOTE}\n{text.strip()}\n" for name, text in sorted(written.items())}


def _index(rules_by_page: dict[str, list[Rule]]) -> str:
    lines = ["# Rules", "", _INTRODUCTION]
    for digit, members in rules_by_page.items():
        name, title, _ = _PAGES[digit]
        rows = [
            (f"[{rule.code}]({name}.md#{rule.code.lower()}-{rule.slug}) {rule.slug}", rule.severity, rule.summary)
            for rule in members
        ]
        lines += [f"## {title}", "", *table(("rule", "severity", "finds"), rows), ""]
    name, title, introduction = _DATA
    rows = [
        (f"[{check.code}]({name}.md#{check.code.lower()}-{check.slug}) {check.slug}", check.severity, check.summary)
        for check in CHECKS
    ]
    lines += [f"## {title}", "", introduction, "", *table(("check", "severity", "holds if"), rows), ""]
    gone = [(f"{entry.code} {entry.slug}", entry.found, f"{entry.reason} {entry.instead}") for entry in retired()]
    lines += [
        "## Retired",
        "",
        _RETIRED,
        "",
        *table(("rule", "reported", "why it is gone, and what proves it"), gone),
        "",
    ]
    return "\n".join(lines)


def _entry(rule: Rule) -> Iterator[str]:
    """Yield the lines of one rule: its requirement, then its documentation with headings without anchors."""
    requirement = spec.requirements()[rule.requirement]
    proves = f"proves [{requirement.id}](../reference/requirements.md)"
    yield from _described(rule, f"*{rule.gate.value} gate; {rule.severity}; {proves}:* {prose(requirement.text)}")


def _described(rule: Rule | type[DemonstrationCheck], what: str) -> Iterator[str]:
    """Yield a title, the summary, what it is, and the sections of a docstring."""
    summary, *sections = rule.documentation.split("\n## ")
    yield from ("", f"## {rule.code} {rule.slug}", "", prose(summary), "", what)
    for section in sections:
        heading, _, text = section.partition("\n")
        yield from ("", f"**{heading}**", "", *text.strip().splitlines())
