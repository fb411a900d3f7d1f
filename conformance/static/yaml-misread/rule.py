"""XPL180: YAML parses each value as its author means it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

import yaml

from xpl import _spec as sdk
from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.source import Source

_SUSPECT: Final = re.compile(
    r"[\s:\[,-](?:[-+]?\d+[eE][-+]?\d+|[-+]?\d+\.\d*[eE]\d+|0\d+|\d+(?::\d\d?)+|\d{4}-\d\d?-\d\d?)(?=\s*(?:[,\]}#\n]|$))"
    r"|(?:name|version|tag|ckpt|checkpoint|run|revision|id)\s*:\s*\d+\.\d*0(?=\s)"
    r"|^\s*(?:y|n|yes|no|on|off)\s*:|[\[,-]\s*(?:yes|no|on|off)\s*(?=[,\]\n]|$)",
    re.MULTILINE | re.IGNORECASE,
)
_TEXTUAL: Final = re.compile(r"[-+]?\d+(?:\.\d*)?[eE][-+]?\d+")
_OCTAL: Final = re.compile(r"[-+]?0[0-7]+")
_CLOCK: Final = re.compile(r"[-+]?[1-9]\d*(?::[0-5]?\d)+")
_ENDS_IN_ZERO: Final = re.compile(r"\d+\.\d*0")
_TRUE: Final = frozenset(("yes", "on"))
_WORDS: Final = _TRUE | {"no", "off"}
_NAMES: Final = re.compile(r"(.*_)?(name|version|tag|ckpt|checkpoint|run|revision|id)")


@rule(code="XPL180", requirement="XPL-CFG-11")
def yaml_misread(source: Source) -> Iterator[Finding]:
    """YAML parses a value of the configuration differently from how it looks.

    ## What it does
    Looks in `deploy.yml` and `policy.yml` for values that YAML 1.1 parses differently from how they look: `1e-4` is a
    string, 010 is 8, `1:30` is 90, a date is not a string, `1.10` as a name loses its zero, and `no` or `on` in a list
    or as a key is a boolean.

    ## Why it matters
    A learning rate that is a string fails late, or is compared as a string. Checkpoint 010 is looked up as 8, which may
    be another policy.

    ## Example
    `noise: 1e-4` and `ckpt_name: 010`.

    ## Use instead
    `noise: 1.0e-4` and `ckpt_name: "010"`.

    ## Fix safety
    Safe for `1.0e-4`, which equals `float("1e-4")`. Quotes turn a number into a string, which code may not expect.
    """
    for file in (sdk.File.DEPLOY_YML, sdk.File.POLICY_YML):
        if not source.has(file) or not _SUSPECT.search(source.text(file)) or source.yaml_problem(file) is not None:
            continue
        for key, node in _scalars(source.yaml_root(file), ""):
            read = _misread(key, node)
            if read is not None:
                yield _finding(file, key, node, read)


def _scalars(node: yaml.Node | None, key: str, *, listed: bool = False) -> Iterator[tuple[str, yaml.ScalarNode]]:
    """Yield the plain values below a node with the key that they stand under; "[]" behind it in a list."""
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            if isinstance(name, yaml.ScalarNode) and not name.style:
                yield "", name
            yield from _scalars(value, str(name.value))
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            yield from _scalars(value, key, listed=True)
    elif isinstance(node, yaml.ScalarNode) and not node.style:
        yield f"{key}[]" if listed else key, node


def _misread(key: str, node: yaml.ScalarNode) -> str | None:
    """Return what YAML makes of a value, None if it is what it looks like."""
    text, tag = str(node.value), node.tag.rpartition(":")[2]
    is_octal, is_clock = _OCTAL.fullmatch(text), _CLOCK.fullmatch(text)
    is_name = _NAMES.fullmatch(key.removesuffix("[]"))
    is_alone = not key or key.endswith("[]")
    readings = {
        "str": "a string" if _TEXTUAL.fullmatch(text) else None,
        "int": f"the number {int(text, 8)}" if is_octal else "a number of seconds" if is_clock else None,
        "timestamp": "a date",
        "float": f"the number {float(text)}" if is_name and _ENDS_IN_ZERO.fullmatch(text) else None,
        "bool": f"the boolean {text.lower() in _TRUE}" if is_alone and text.lower() in _WORDS else None,
    }
    return readings.get(tag)


def _finding(file: str, key: str, node: yaml.ScalarNode, read: str) -> Finding:
    start, end = node.start_mark, node.end_mark
    span = (start.line + 1, start.column + 1, end.line + 1, end.column + 1)
    text = str(node.value)
    is_number = _TEXTUAL.fullmatch(text) is not None
    better = _number(text) if is_number else f'"{text}"'
    what = f"{key.removesuffix('[]')}: " if key else "the key "
    return Finding(
        f"YAML parses {what}{text} as {read}, and the policy runs with that",
        file,
        *span,
        expected=better,
        got=text,
        fix=Fix("safe_edit" if is_number else "unsafe_edit", better, (Edit(file, *span, better),)),
    )


def _number(text: str) -> str:
    """Return a number as YAML 1.1 wants it, with a point and a sign: `1.0e-4` for `1e-4`."""
    mantissa, exponent = re.split("[eE]", text)
    point = "" if "." in mantissa else ".0"
    sign = "" if exponent[0] in "+-" else "+"
    return f"{mantissa}{point}e{sign}{exponent}"
