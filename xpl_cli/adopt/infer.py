"""Reads everything an adapter tells of itself into a draft of its manifest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.adopt import actions, documents, inputs, runtime
from xpl_cli.adopt.facts import Evidence, Fact, Finding, Question, certain
from xpl_cli.adopt.values import Values
from xpl_cli.audit.rules.model import NotApplicable, NotRun
from xpl_cli.audit.static.adapter import Adapter
from xpl_cli.basics.errors import UserError
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from xpl_cli.audit.static.source import Source


_VERSION: Final = "spec"


@dataclass(frozen=True)
class Draft:
    """What the manifest of one adapter will say.

    Attributes:
        facts: what is known, by key.
        questions: what is not, by key.
        notes: what kept something from being read.
        native: the native block that a checkpoint told, a tree of values with their sources; None without one.
    """

    facts: dict[str, Fact]
    questions: dict[str, Question]
    notes: tuple[str, ...] = ()
    native: Any = None


def draft(source: Source, given: Mapping[str, Any]) -> Draft:
    """Infer a manifest.

    Args:
        source: the adapter's files.
        given: values of the user's own, by dotted key; they outrank what is read.

    Raises:
        UserError: if the manifest has no such key.
    """
    notes: list[str] = []
    found = [certain("name", source.path.name, Evidence("", None, "the folder's name"))]
    chosen = [certain(key, value, Evidence("", None, "given with --set")) for key, value in given.items()]
    for key in given:
        _check_key(key)
    everything = [*found, *_findings(source, {fact.key: fact for fact in chosen}, notes)]
    facts = {entry.key: entry for entry in everything if isinstance(entry, Fact)}
    questions = {entry.key: entry for entry in everything if isinstance(entry, Question)}
    for fact in chosen:
        for key in [key for key in (*facts, *questions) if key == fact.key or key.startswith(f"{fact.key}.")]:
            facts.pop(key, None)
            questions.pop(key, None)
        facts[fact.key] = fact
    questions = {key: question for key, question in questions.items() if key not in facts}
    questions |= {question.key: question for question in _gaps([*facts, *questions])}
    return Draft(facts, questions, tuple(notes))


def _findings(source: Source, given: Mapping[str, Fact], notes: list[str]) -> Iterator[Finding]:
    texts = documents.Documents(source)
    publication = list(documents.publication(texts))
    yield from publication
    title = next((str(entry.value["title"]) for entry in publication if isinstance(entry, Fact)), "")
    yield from documents.family(texts, title)
    yield from documents.upstream(texts)
    yield from documents.robots(texts)
    yield from documents.downloads(texts)
    yield from runtime.environment(texts)
    yield from runtime.scripts(source)
    yield from runtime.methods(source)
    try:
        values = Values(source, Adapter.of(source))
    except (NotRun, NotApplicable) as problem:
        notes.append(f"what the model reads and answers is not known: {problem}")
        return
    told = next((evidence for evidence, _ in documents.commands(texts)), None)
    kinds = list(actions.action_types(values, told))
    yield from kinds
    yield from actions.temporal(values)
    yield from actions.rate(values)
    yield from actions.gripper(values)
    declared = given.get("action_types") or next((entry for entry in kinds if isinstance(entry, Fact)), None)
    yield from inputs.inputs(values, list(declared.value) if declared is not None else [])


def _gaps(known: Iterable[str]) -> Iterator[Question]:
    """Yield a question for each key that the manifest must have and that nothing was said about."""
    there = {key for name in known for key in (name, name.partition(".")[0])}
    schema = spec.schema("policy")
    for name in schema["required"]:
        entry = schema["properties"][name]
        for inner in entry.get("required", ()):
            yield from _gap(f"{name}.{inner}", entry["properties"][inner], known)
        if "required" not in entry and name not in there and name != _VERSION:
            yield from _gap(name, entry, known)


def _gap(key: str, entry: Mapping[str, Any], known: Iterable[str]) -> Iterator[Question]:
    if key in known or key.partition(".")[0] in known:
        return
    options = entry.get("enum") or entry.get("items", {}).get("enum") or ()
    stand_in: Any = {} if entry.get("type") == "object" else None
    yield Question(key, entry.get("description", key), tuple(map(str, options)), stand_in=stand_in)


def _check_key(key: str) -> None:
    from xpl_cli.standard.problems import nearest

    schema: Any = spec.schema("policy")
    for part in key.split("."):
        below = schema.get("properties", {})
        if isinstance(schema.get("additionalProperties"), dict):
            schema = schema["additionalProperties"]
        elif part in below:
            schema = below[part]
        else:
            near = nearest(part, below)
            hint = (
                f"did you mean {near}?"
                if near
                else f"`xpl spec show {sdk.File.POLICY_YML.partition('.')[0]}` lists them"
            )
            raise UserError(f"--set {key}: the manifest has no key {part!r} there", hint=hint)
        if "anyOf" in schema or "$ref" in schema:
            return
