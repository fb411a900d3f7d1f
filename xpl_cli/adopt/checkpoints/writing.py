"""Writes trees of told values as YAML: each value with its source beside it, and what is open as `{unknown: why}`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.adopt.facts import Open, Told, Tree, plain
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_WIDTH: Final = 118
_TOP: Final = re.compile(r"^([A-Za-z_]\w*):", re.MULTILINE)


def section(key: str, tree: Tree) -> str:
    """Return one top-level key of a manifest as YAML."""
    return "\n".join(_entry(key, tree, 0)) + "\n"


def replaced(text: str, sections: Mapping[str, str]) -> str:
    """Return a manifest with some of its top-level keys replaced, and what it lacks added at its end.

    Args:
        text: the manifest, with its comments.
        sections: key to its YAML.
    """
    found = list(_TOP.finditer(text))
    ends = [*(match.start() for match in found[1:]), len(text)]
    result = [text[: found[0].start()] if found else text]
    for match, end in zip(found, ends, strict=True):
        result.append(sections.get(match[1], text[match.start() : end]))
    there = {match[1] for match in found}
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
    """Yield one entry of a list: its lines, the first value of which gets the dash."""
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
    """Yield a line with its source beside it, or above it where it would get too long."""
    comment = _comment(tree)
    if comment and len(line) + len(comment) + 3 > _WIDTH:
        yield f"{indent}# {comment}"
        yield line
    else:
        yield f"{line} # {comment}" if comment else line


def _comment(tree: Tree) -> str:
    if isinstance(tree, Told):
        return _one_line(tree.comment)
    if not isinstance(tree, Open):
        return ""
    marked = [] if tree.stand_in is None else [f"{spec.data('package')['placeholder']}: {tree.reason}"]
    seen = [f"seen: {'; '.join(map(str, tree.seen))}"] if tree.seen else []
    return _one_line("; ".join([*marked, *seen]))


def _one_line(words: str) -> str:
    """Return a text that can stand in a comment: one line, and nothing that YAML forbids."""
    return "".join(char if char.isprintable() else " " for char in words).strip()[:400]


def _has_sources(tree: Tree) -> bool:
    if isinstance(tree, dict):
        return any(isinstance(value, (Told, Open)) or _has_sources(value) for value in tree.values())
    if isinstance(tree, list):
        return any(isinstance(value, (Told, Open)) or _has_sources(value) for value in tree)
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
