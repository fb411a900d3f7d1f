"""Writes the draft of a manifest as YAML in which every value says where it was read, and every gap is marked."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.adopt.facts import Fact, Question
from xpl_cli.basics.errors import UserError
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from xpl_cli.adopt.infer import Draft
    from xpl_cli.standard.problems import Problem

_SCHEMA = "policy"
_WIDTH = 118
_HEAD = """\
# Read by `xpl adopt` from the adapter's files; nothing of it was run. Every value says where it was read:
# certain: a file says exactly this; likely: it is named where this is usually told, so look again;
# assumed: nothing says otherwise, and the ecosystem's contract says this. All keys: `xpl spec show policy`.
"""


def value_of(draft: Draft) -> dict[str, Any]:
    """Return the manifest as a map; what is not known is null, or an empty list where there must be one."""
    document: dict[str, Any] = {"spec": spec.CURRENT if draft.native is None else spec.NEWEST}
    entries = {key: question.stand_in for key, question in draft.questions.items()}
    entries |= {key: fact.value for key, fact in draft.facts.items()}
    for key, value in entries.items():
        *above, name = key.split(".")
        place = document
        for part in above:
            place = place.setdefault(part, {})
        place[name] = value
    return _ordered(document, spec.schema(_SCHEMA))


def _ordered(value: dict[str, Any], schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return a map with its keys in the order of its schema."""
    order = list(schema.get("properties", {}))
    if not order:
        return value
    inner = schema["properties"]
    return {
        key: _ordered(entry, inner[key]) if isinstance(entry, dict) and key in inner else entry
        for key, entry in sorted(
            value.items(), key=lambda entry: order.index(entry[0]) if entry[0] in order else len(order)
        )
    }


def text(draft: Draft) -> str:
    """Return the manifest as YAML with the source of every value."""
    lines = [line for key, value in value_of(draft).items() for line in _entry(key, value, draft, 0)]
    return _HEAD + "\n".join(lines) + "\n" + (_native(draft) if draft.native is not None else "")


def _native(draft: Draft) -> str:
    """Return the block that a checkpoint told."""
    from xpl_cli.adopt.checkpoints import writing
    from xpl_cli.adopt.checkpoints.known import NATIVE

    return writing.section(NATIVE, draft.native)


def addition(draft: Draft, existing: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Return what a manifest that is there lacks, as YAML to append, and the names of its keys."""
    wanted = value_of(draft)
    names = [key for key in wanted if key not in existing and _is_worth_it(key, draft)]
    lines = [line for key in names for line in _entry(key, wanted[key], draft, 0)]
    body = "\n".join([*lines, ""]) if lines else ""
    if draft.native is not None and "native" not in existing:
        body += _native(draft)
        names.append("native")
    return f"# Added by `xpl adopt`:\n{body}" if body else "", names


def unexplained(content: str, draft: Draft) -> list[Problem]:
    """Return the problems of a manifest that no open question explains: values given by the user that do not fit."""
    from xpl_cli.standard.validate import validate_yaml

    _, problems = validate_yaml(content.encode(), sdk.File.POLICY_YML, _SCHEMA, None)
    return [problem for problem in problems if not any(_concerns(problem, key) for key in draft.questions)]


def check(content: str, draft: Draft) -> None:
    """Check that a draft is valid but for its open questions.

    Raises:
        UserError: with the first value that is not.
    """
    for problem in unexplained(content, draft):
        raise UserError(
            f"{'.'.join(map(str, problem.path)) or 'the manifest'}: {problem.told}", hint=f"`xpl spec show {_SCHEMA}`"
        )


def _is_worth_it(key: str, draft: Draft) -> bool:
    """Tell whether a key that is missing is required, or known."""
    return key in spec.schema(_SCHEMA)["required"] or any(
        known == key or known.startswith(f"{key}.") for known in draft.facts
    )


def _concerns(problem: Problem, key: str) -> bool:
    parts = tuple(key.split("."))
    there = tuple(map(str, problem.path))
    return there[: len(parts)] == parts or (parts[: len(there)] == there and problem.missing == parts[-1])


def _entry(key: str, value: Any, draft: Draft, depth: int) -> Iterator[str]:
    """Yield the lines of one key: its comment beside it, or above it where the line would get too long."""
    indent, name = "  " * depth, key.rpartition(".")[2]
    source = draft.facts.get(key) or draft.questions.get(key)
    if source is None and isinstance(value, dict):
        yield f"{indent}{name}:"
        for inner, entry in value.items():
            yield from _entry(f"{key}.{inner}", entry, draft, depth + 1)
        return
    if isinstance(source, Fact) and source.is_itemised:
        yield f"{indent}{name}: # {source.confidence}"
        yield from (f"{indent}  - {item} # {place}" for item, place in zip(value, source.evidence, strict=True))
        return
    body = _dump(name, value, indent)
    comment = _comment(source)
    beside = f"{body[0]} # {comment}" if comment else body[0]
    if len(beside) <= _WIDTH or not comment:
        yield beside
    else:
        yield f"{indent}# {comment}"
        yield body[0]
    yield from body[1:]


def _comment(source: Fact | Question | None) -> str:
    if isinstance(source, Question):
        return f"{spec.data('package')['placeholder']}: {_plain(source.text)}"
    if source is None:
        return ""
    return _plain(source.comment) if source.evidence else f"{source.confidence}: nothing that the code shows"


def _plain(words: str) -> str:
    """Return a text that can stand in a comment: one line, and nothing that YAML forbids."""
    return re.sub(r"[^\x20-\x7e\xa0-\ud7ff\ue000-\ufffd]+", " ", words).strip()


def _dump(name: str, value: Any, indent: str) -> list[str]:
    import yaml

    simple = isinstance(value, list) and not any(isinstance(entry, (dict, list)) for entry in value)
    flow = simple or (isinstance(value, dict) and len(str(value)) < _WIDTH // 2)
    shown = yaml.safe_dump(
        {name: value}, sort_keys=False, allow_unicode=True, width=10_000, default_flow_style=None if flow else False
    )
    if flow and not isinstance(value, (str, int, float, bool, type(None))):
        inner = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=10_000, default_flow_style=True)
        shown = f"{name}: {inner.strip()}"
    return [f"{indent}{line}" for line in shown.rstrip("\n").split("\n")]
