"""Reference pages of the standard, generated from `spec/` as Markdown; a test compares them."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from xpl_cli.standard import robots, spec
from xpl_cli.standard.view import OPEN, OPEN_MEANS, PARTS, SchemaSection, sections
from xpl_cli.standard.vocabulary import vocabularies

if TYPE_CHECKING:
    from xpl_cli.audit.rules.registry import Rule

NOTE = "<!-- Written by `xpl spec compile`. Do not edit. -->\n"
"""First line of every generated page."""

_UNKNOWN = "not known"
_CATALOGUE = (
    "Each is a module of `xpl/conventions/`: its code there and back, and its usual mistakes, which an audit tries "
    "when an adapter differs from `reference.py` ([model_io](../model-io.md)) or from demonstrations. `xpl explain "
    "NAME` says the same in a terminal. Another one is [added as one file](../extending.md#a-convention)."
)


def pages() -> dict[str, str]:
    """Return every page, file name to text."""
    written = {
        "README": _index(),
        "embodiments": _embodiments(),
        "catalogue": _catalogue(),
        "requirements": _requirements(),
        **{name: _part(name) for name in PARTS if name != "requirements"},
        **{name: _schema(name) for name in spec.schema_names()},
    }
    return {f"{name}.md": f"{NOTE}\n{text.strip()}\n" for name, text in sorted(written.items())}


def _index() -> str:
    manifests = ("policy", "deploy", "env")
    others = [name for name in spec.schema_names() if name not in manifests]
    groups = {
        "Manifests": manifests,
        "Rules of behaviour": ("requirements", *(name for name in PARTS if name != "requirements"), "embodiments"),
        "Conventions of adapters": ("catalogue",),
        "Documents and messages": others,
    }
    lines = [f"# Reference of the standard, {spec.VERSION}"]
    for heading, names in groups.items():
        lines += ["", f"## {heading}", "", *(f"- [{_title(name)}]({name}.md)" for name in names)]
    return "\n".join(lines)


def _title(name: str) -> str:
    if name in spec.schema_names():
        return str(spec.schema(name)["title"])
    return f"{name.capitalize()}: {PARTS[name]}" if name in PARTS else name.capitalize()


def _part(name: str) -> str:
    text = spec.text(f"{name}.yml")
    return f"# {name.capitalize()}\n\n{PARTS[name].capitalize()}.\n\n```yaml\n{text.rstrip()}\n```"


def _schema(name: str) -> str:
    schema = spec.schema(name)
    lines = [f"# {schema['title']}", "", str(schema.get("description", ""))]
    for section in sections(schema):
        lines += ["", *([f"## {section.name}", ""] if section.name else []), *_keys(section)]
        lines += ["", OPEN_MEANS] if any(row.kind.endswith(OPEN) for row in section.rows) else []
    for choice in vocabularies(schema):
        rows = [(f"`{word.name}`", word.description) for word in choice.values]
        lines += [
            "",
            f"## Words of {choice.key}",
            "",
            f"{prose(choice.meaning)}.",
            "",
            *table(("word", "meaning"), rows),
        ]
    return "\n".join(lines)


def _keys(section: SchemaSection) -> Iterator[str]:
    if not section.rows:
        yield section.summary.strip()
        return
    rows = [
        (f"`{'.'.join(row.path)}`", "yes" if row.required else "", f"`{row.kind}`", row.meaning) for row in section.rows
    ]
    yield from table(("key", "required", "value", "meaning"), rows)


def _requirements() -> str:
    """Write every requirement with the rules that prove it."""
    from xpl_cli.audit.rules.registry import builtin_entries

    proofs: dict[str, list[Rule]] = {}
    for rule in (entry.load() for entry in builtin_entries()):
        proofs.setdefault(rule.requirement, []).append(rule)
    areas: dict[str, list[tuple[str, ...]]] = {}
    for entry in spec.requirements().values():
        rules_text = ", ".join(f"{rule.code} {rule.slug}" for rule in proofs.get(entry.id, ()))
        row = (entry.id, entry.level, entry.text, entry.source, entry.harm, rules_text)
        areas.setdefault(entry.area.capitalize(), []).append(row)
    lines = [
        "# Requirements",
        "",
        "A MUST that does not hold fails an audit, a SHOULD warns. Source: contract of the field, its wire protocol, a",
        "fault found in the field, or a decision of this standard (xpl). `xpl explain RULE` tells more.",
        "",
        "Harm is what a package does that violates the requirement. Reports list findings in this order:",
        "",
        *(f"- `{name}`: {sentence}" for name, sentence in spec.harms().items()),
    ]
    for area, rows in areas.items():
        lines += ["", f"## {area}", "", *table(("id", "level", "requirement", "source", "harm", "rules"), rows)]
    return "\n".join(lines)


_ROBOTS = """\
Robots that come with `xpl` (`spec/robots`). A project describes its own in the same form, in `embodiments/NAME.yml`
([robots](../robots.md)). `xpl spec show` lists all of them, with where each is from."""


def _catalogue() -> str:
    """Write what an adapter and its model have to share."""
    from xpl.catalogue.convention import conventions
    from xpl_cli.model_io import description

    lines = ["# Conventions that an adapter and its model share", "", _CATALOGUE]
    for one in conventions():
        lines += [
            "",
            *(
                f"#{line}" if line.startswith("# ") else line
                for line in description.render_markdown(description.describe(one))
            ),
        ]
    return "\n".join(lines)


def _embodiments() -> str:
    known = robots.entries()
    words: dict[str, list[str]] = {}
    for word, name in robots.aliases().items():
        words.setdefault(name, []).append(word)
    rows = [
        (
            f"`{name}`",
            ", ".join([*(entry.get("aliases") or ()), *words.get(name, ())]),
            f"{len(entry['arms'])} x {entry['arm']['dof']}",
            f"{entry['end_effector']['kind']}, {entry['end_effector']['dim']}",
            _UNKNOWN if entry["arm"]["joints"] is None else "known",
            entry.get("description", ""),
        )
        for name, entry in known.items()
    ]
    lines = ["# Embodiments", ""]
    lines += [_ROBOTS, ""]
    lines += table(("name", "aliases", "arms x joints", "end effector", "limits", ""), rows)
    for name, entry in known.items():
        joints = entry["arm"]["joints"]
        if joints is None:
            continue
        lines += ["", f"## {name}", ""]
        lines += table(
            ("joint", "from, rad", "to, rad", "speed, rad/s"),
            [(joint["name"], *map(str, joint["limits"]), str(joint.get("velocity") or _UNKNOWN)) for joint in joints],
        )
        lines += ["", *(f"- {note}" for note in (*entry.get("sources", ()), *entry.get("caveats", ())))]
    return "\n".join(lines)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table in Markdown."""
    yield f"| {' | '.join(head)} |"
    yield f"|{' --- |' * len(head)}"
    for row in rows:
        yield f"| {' | '.join(map(prose, row))} |"


def prose(text: object) -> str:
    """Return a text as a line of Markdown, also in a table, that every renderer reads alike.

    A stroke in code is written as HTML, because some show the backslash that others need there; `__init__` in prose is
    a name, and no emphasis.
    """
    parts = re.split(r"(`[^`]*`)", " ".join(str(text).split()))
    return "".join(
        (_code(part) if part.startswith("`") else part.replace("|", "\\|").replace("__", "\\_\\_")) for part in parts
    )


def _code(span: str) -> str:
    if "|" not in span:
        return span
    return f"<code>{html.escape(span.strip('`')).replace('|', '&#124;')}</code>"
