"""YAML output of fact trees: each value with its source as a comment, unknown values as `{unknown: why}`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.adopt.facts import Fact, Tree, UnknownFact, plain
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_WIDTH: Final = 118
_TOP: Final = re.compile(r"^([A-Za-z_]\w*):", re.MULTILINE)


def section(key: str, tree: Tree) -> str:
    """Return one top-level key of a manifest as YAML."""
    return "\n".join(_entry(key, tree, 0)) + "\n"


def replace_sections(text: str, sections: Mapping[str, str]) -> str:
    """Replace top-level keys of a manifest; append those that it lacks.

    Args:
        text: the manifest, with its comments.
        sections: YAML of each key.
    """
    matches = list(_TOP.finditer(text))
    ends = [*(match.start() for match in matches[1:]), len(text)]
    result = [text[: matches[0].start()] if matches else text]
    for match, end in zip(matches, ends, strict=True):
        result.append(sections.get(match[1], text[match.start() : end]))
    there = {match[1] for match in matches}
    result += [body for key, body in sections.items() if key not in there]
    return "".join(result)


def _entry(key: str, tree: Tree, depth: int) -> Iterator[str]:
    indent, key = "  " * depth, _flow(key)
    if isinstance(tree, dict) and _has_sources(tree):
        yield f"{indent}{key}:"
        for name, value in tree.items():
            yield from _entry(name, value, depth + 1)
    elif isinstance(tree, list) and _has_sources(tree):
        yield f"{indent}{key}:"
        for value in tree:
            yield from _item(value, depth + 1)
    elif isinstance(tree, dict) and len(f"{indent}{key}: {_flow(tree)}") > _WIDTH:
        yield f"{indent}{key}:"
        for name, value in tree.items():
            yield from _entry(name, value, depth + 1)
    else:
        yield from _commented(f"{indent}{key}: {_flow(tree)}", indent, tree)


def _item(tree: Tree, depth: int) -> Iterator[str]:
    """Yield the lines of a list entry; the first value gets the dash."""
    indent = "  " * depth
    if not (isinstance(tree, dict) and _has_sources(tree)):
        yield from _commented(f"{indent}- {_flow(tree)}", indent, tree)
        return
    lines = [line for name, value in tree.items() for line in _entry(name, value, depth + 1)]
    dashed = False
    for line in lines:
        if dashed or line.lstrip().startswith("#"):
            yield line
        else:
            dashed = True
            yield f"{indent}- {line.removeprefix(indent + '  ')}"


def _commented(line: str, indent: str, tree: Tree) -> Iterator[str]:
    """Yield a line with its source as trailing comment, or as comment above where the line is too long."""
    comment = _comment(tree)
    if comment and len(line) + len(comment) + 3 > _WIDTH:
        yield f"{indent}# {comment}"
        yield line
    else:
        yield f"{line} # {comment}" if comment else line


def _comment(tree: Tree) -> str:
    if isinstance(tree, Fact):
        return _one_line(tree.comment)
    if not isinstance(tree, UnknownFact):
        return ""
    marked = [] if tree.placeholder is None else [f"{spec.data('package')['placeholder']}: {tree.reason}"]
    sources = [f"see {'; '.join(map(str, tree.evidence))}"] if tree.evidence else []
    return _one_line("; ".join([*marked, *sources]))


def _one_line(text: str) -> str:
    """Return text that is valid in a YAML comment: one line of printable characters."""
    return "".join(char if char.isprintable() else " " for char in text).strip()[:400]


def _has_sources(tree: Tree) -> bool:
    if isinstance(tree, dict):
        return any(isinstance(value, (Fact, UnknownFact)) or _has_sources(value) for value in tree.values())
    if isinstance(tree, list):
        return any(isinstance(value, (Fact, UnknownFact)) or _has_sources(value) for value in tree)
    return False


def _flow(tree: Tree) -> str:
    """Return a value on one line."""
    import yaml

    value: Any = plain(tree)
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=10_000_000, default_flow_style=True)
    text = text.removesuffix("\n").removesuffix("...").strip()
    if isinstance(value, dict) and len(value) > 0 and text.startswith("{"):
        return "{ " + text[1:-1] + " }"
    return text
