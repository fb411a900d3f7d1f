"""XPL704: What is called left comes from the left."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.manifests import location_in
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import targets

_SIDES: Final = ("left", "right")
_WORDS: Final = re.compile(r"[A-Za-z]+")
_ON_PURPOSE: Final = frozenset(("swap", "swapped", "mirror", "mirrored", "flip", "flipped", "other", "opposite"))


@rule(code="XPL704", requirement="XPL-OBS-7")
def sides_mixed(source: Source) -> Iterator[Finding]:
    """What is called left is filled with what is called right, or the other way round.

    ## What it does
    Compares, in deploy.yml, in model.py and in what observations and actions pass through, the names of entries,
    variables and arguments with the names that their values are made of: `left` on one side and only `right` on the
    other.

    ## Why it matters
    It is the mistake of a copied line: one wrist camera is shown twice and the other never, or an arm gets the other
    arm's command. Every check of names and shapes passes.

    ## Example
    `{"image_right": images["cam_left_wrist"]}`.

    ## Use instead
    The camera or the arm of the same side. A model that was trained with the sides exchanged needs a comment and a
    name that says so, such as `swapped`.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    functions = adapter.reach(*OBSERVING, *ACTING)
    places: list[tuple[str, ast.AST]] = [(function.file, node) for function in functions for node in function.nodes]
    inside = {id(node) for _, node in places}
    places += [(sdk.File.MODEL_PY, node) for node in source.nodes(sdk.File.MODEL_PY) if id(node) not in inside]
    for path, text in _configured(source.deploy):
        side, other = _side(str(path[-1])), _side(text)
        if side and other and side != other:
            yield Finding(
                f"what is called {side} is filled with what is called {other}",
                **location_in(source, sdk.File.DEPLOY_YML, path),
                expected=side,
                got=text[:80],
                fix=Fix("advice", "name the one of the same side"),
            )
    reported: set[tuple[str, int]] = set()
    for file, node in places:
        for name, value in _pairs(node):
            side, other = _side(name), _side(value)
            place = (file, getattr(value, "lineno", 0))
            is_offset = isinstance(value, ast.BinOp)  # `right = left + width`
            if side and other and side != other and not is_offset and place not in reported:
                reported.add(place)
                yield Finding(
                    f"what is called {side} is filled with what is called {other}",
                    **source.at(file, value),
                    expected=side,
                    got=ast.unparse(value)[:80],
                    fix=Fix("advice", "take it from the same side, or say in a name that the sides are swapped"),
                )


def _configured(entry: object, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield the texts of a configuration with their places."""
    if isinstance(entry, dict):
        for key, value in entry.items():
            yield from _configured(value, (*path, str(key)))
    elif isinstance(entry, str) and path:
        yield path, entry


def _pairs(node: ast.AST) -> Iterator[tuple[ast.AST | str, ast.expr]]:
    """Yield names with the values that they get."""
    if isinstance(node, ast.Dict):
        yield from ((key, value) for key, value in zip(node.keys, node.values, strict=True) if key is not None)
    elif isinstance(node, ast.Assign) and len(node.targets) == 1:
        yield from ((target, node.value) for target in targets(node))
    elif isinstance(node, ast.keyword) and node.arg:
        yield node.arg, node.value


def _side(node: ast.AST | str) -> str | None:
    """Return the one side that the names of an expression tell; None for none, both, or an exchange on purpose."""
    texts = [node] if isinstance(node, str) else list(_texts(node))
    words = {word for text in texts for word in _WORDS.findall(text.lower().replace("_", " "))}
    sides = [side for side in _SIDES if side in words]
    return sides[0] if len(sides) == 1 and not words & _ON_PURPOSE else None


def _texts(node: ast.AST) -> Iterator[str]:
    for child in ast.walk(node):
        if isinstance(child, ast.Constant) and isinstance(child.value, str):
            yield child.value
        elif isinstance(child, (ast.Name, ast.Attribute)):
            yield child.id if isinstance(child, ast.Name) else child.attr
        elif isinstance(child, ast.keyword) and child.arg:
            yield child.arg
