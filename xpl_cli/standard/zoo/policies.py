"""Policies of the field, read from `spec/zoo/`: facts with their sources, and proofs that `xpl zoo prove` wrote.

spec/zoo/policies/NAME.yml   what is known of a policy, written by people
spec/zoo/proofs/NAME.json    how far it was proven to run, written by the tool
spec/zoo/words.yml           what levels and families are called, and mean
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final, NotRequired, TypedDict

from xpl import json_text
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import UnknownTargetError, no_such
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from pathlib import Path

_READ: Final = {"robots": "embodiments", "control": "action_types", "chunk": "temporal.chunk"}
"""Facts that a manifest says too, by its key: what a proof read there stands in for what nobody wrote down."""


@dataclass(frozen=True)
class ZooFact:
    """What is known of one thing.

    Attributes:
        value: None where it is not known.
        source: where it was read.
        unknown: why it is not known; None where it is.
        note: what else a reader should know.
    """

    value: Any = None
    source: str | None = None
    unknown: str | None = None
    note: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return it for programs."""
        return {"value": self.value, "source": self.source, "unknown": self.unknown, "note": self.note}


class Tool(TypedDict):
    """What proved a policy; `commit` is None for an installed version."""

    name: str
    version: str
    commit: str | None


class ProvenAdapter(TypedDict):
    """What was proven: an adapter in a checkout, by its commit and the hash of its files."""

    folder: str
    commit: str | None
    files: str


class GateProof(TypedDict):
    """What one gate came to; rules by their codes."""

    gate: str
    outcome: str
    counts: dict[str, int]
    failed: list[str]
    not_run: list[str]
    reason: str | None
    digest: str | None
    fingerprint: str | None


class ManifestValue(TypedDict):
    """What a manifest says of one key, and where."""

    value: Any
    source: str


class RecordedRun(TypedDict):
    """The recorded run of a policy's weights."""

    run: str
    environment: str
    checkpoint: str
    episodes: int
    successes: int


class ZooProof(TypedDict):
    """How far a policy was proven to run: a file of `proofs/`, as `proof.schema.json` has it."""

    name: str
    level: int
    date: str
    tool: Tool
    command: str
    adapter: ProvenAdapter
    spec: str
    verdict: str
    statement: str
    gates: list[GateProof]
    read: dict[str, ManifestValue]
    next: str | None
    run: NotRequired[RecordedRun]


@dataclass(frozen=True)
class Level:
    """One step of how far a policy was carried.

    Attributes:
        number: from 0.
        word: its name.
        meaning: one sentence without its full stop.
    """

    number: int
    word: str
    meaning: str


@dataclass(frozen=True)
class ZooPolicy:
    """A policy of the field.

    Attributes:
        name: folder of its adapter.
        title: what people call it.
        in_paper: whether it is in the paper's table.
        facts: by name, every one that the schema has, in its order.
        proof: how far it was proven; None if it was not run.
    """

    name: str
    title: str
    in_paper: bool
    facts: Mapping[str, ZooFact]
    proof: ZooProof | None = None

    @property
    def level(self) -> Level:
        """How far it was carried."""
        return levels()[0 if self.proof is None else self.proof["level"]]

    @property
    def gates(self) -> Sequence[GateProof]:
        """The gates that judged it."""
        return () if self.proof is None else self.proof["gates"][: self.proof["level"]]

    @property
    def outcome(self) -> str | None:
        """What came out where it was judged, in a few words; None where it was not."""
        if self.proof is None:
            return None
        failed, silent = (
            sum(len(gate["failed"]) for gate in self.gates),
            sum(len(gate["not_run"]) for gate in self.gates),
        )
        told = f"{_rules(failed)} failed" if failed else "nothing wrong"
        return f"{told}, {_rules(silent)} could not run" if silent else told

    @property
    def prover(self) -> str | None:
        """The version of xpl that proved it, with its commit as far as known; None where it was not run."""
        if self.proof is None:
            return None
        tool = self.proof["tool"]
        return f"xpl {tool['version']}" + (f" ({tool['commit'][:8]})" if tool["commit"] else "")

    @property
    def next(self) -> str | None:
        """Why it is not carried further; None at the last level."""
        if self.proof is not None:
            return self.proof["next"]
        return self.facts["adapter"].unknown or "not run here yet"

    @property
    def family(self) -> str | None:
        """Its family; None where that is not known."""
        told: str | None = self.facts["family"].value
        return told


def _rules(number: int) -> str:
    return f"{number} rule{'' if number == 1 else 's'}"


def folder() -> Path:
    """Return where the zoo is."""
    return content_folder("spec") / "zoo"


def proof_path(name: str) -> Path:
    """Return where the proof of a policy is, or will be."""
    return folder() / "proofs" / f"{name}.json"


@cache
def levels() -> tuple[Level, ...]:
    """Return the levels, from nothing upwards."""
    return tuple(Level(number, **entry) for number, entry in enumerate(_vocabulary()["levels"]))


@cache
def schema(name: str) -> dict[str, Any]:
    """Return the schema of a file of the zoo: `policy` or `proof`."""
    read: dict[str, Any] = json_text.parse((folder() / f"{name}.schema.json").read_bytes())
    return read


@cache
def fact_names() -> tuple[str, ...]:
    """Return everything that may be known of a policy, in the order in which it is told."""
    properties = schema("policy")["properties"]
    return tuple(name for name, entry in properties.items() if entry.get("$ref") == "#/$defs/fact")


@cache
def policies() -> tuple[ZooPolicy, ...]:
    """Return every policy, sorted by its name whatever its case."""
    found = sorted((folder() / "policies").glob("*.yml"), key=lambda path: (path.stem.lower(), path.stem))
    return tuple(_policy(path.stem) for path in found)


def names() -> list[str]:
    """Return the names of all policies."""
    return [policy.name for policy in policies()]


def find(name: str) -> ZooPolicy:
    """Return a policy by its name.

    Raises:
        UnknownTargetError: if the zoo has none of that name.
    """
    for policy in policies():
        if policy.name == name:
            return policy
    raise no_such(f"the zoo has no policy {name!r}", name, names(), listing="xpl zoo", kind=UnknownTargetError)


@cache
def families() -> dict[str, str]:
    """Return what every family is called, by its name."""
    told: dict[str, str] = _vocabulary()["families"]
    return told


@cache
def _vocabulary() -> dict[str, Any]:
    told: dict[str, Any] = spec.read_yaml(folder() / "words.yml")
    return told


def _policy(name: str) -> ZooPolicy:
    told = spec.read_yaml(folder() / "policies" / f"{name}.yml")
    path = proof_path(name)
    proof: ZooProof | None = json_text.parse(path.read_bytes()) if path.is_file() else None
    facts = {key: ZooFact(**told[key]) if key in told else ZooFact(unknown=told["otherwise"]) for key in fact_names()}
    for key, manifest_key in _READ.items():
        read = None if proof is None else proof["read"].get(manifest_key)
        if read is not None and facts[key].value is None:
            facts[key] = ZooFact(read["value"], f"manifest, {read['source']}", note=facts[key].note)
    return ZooPolicy(told["name"], told["title"], told["in_paper"], facts, proof)
