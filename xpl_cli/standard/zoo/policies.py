"""Published policies, read from `spec/zoo/`: facts with sources, and proofs written by `xpl zoo prove`.

spec/zoo/policies/NAME.yml   facts of a policy, written by maintainers
spec/zoo/proofs/NAME.json    how far the policy was proven to run, written by the tool
spec/zoo/words.yml           names and meanings of levels and families
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
"""Facts that a manifest also has, by its key: a proof's value replaces a missing fact."""


@dataclass(frozen=True)
class ZooFact:
    """A fact of a policy.

    Attributes:
        value: None if unknown.
        source: its source.
        unknown: why it is unknown; None if it is known.
        note: further information.
    """

    value: Any = None
    source: str | None = None
    unknown: str | None = None
    note: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the fact as JSON."""
        return {"value": self.value, "source": self.source, "unknown": self.unknown, "note": self.note}


class Tool(TypedDict):
    """The tool that proved a policy; `commit` is None for an installed version."""

    name: str
    version: str
    commit: str | None


class ProvenAdapter(TypedDict):
    """The proven adapter, by its commit and the hash of its files."""

    folder: str
    commit: str | None
    files: str


class GateProof(TypedDict):
    """The result of one gate; rules by their codes."""

    gate: str
    outcome: str
    counts: dict[str, int]
    failed: list[str]
    not_run: list[str]
    reason: str | None
    digest: str | None
    fingerprint: str | None


class ManifestValue(TypedDict):
    """A value of a manifest, and its source."""

    value: Any
    source: str


class RecordedRun(TypedDict):
    """A recorded run with a policy's weights."""

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
    """A level of proof.

    Attributes:
        number: index from 0.
        word: its name.
        meaning: one sentence without its full stop.
    """

    number: int
    word: str
    meaning: str


@dataclass(frozen=True)
class ZooPolicy:
    """A published policy.

    Attributes:
        name: folder of its adapter.
        title: its common name.
        in_paper: whether it is in the paper's table.
        facts: all facts of the schema by name, in its order.
        proof: how far it was proven; None if it was never run.
    """

    name: str
    title: str
    in_paper: bool
    facts: Mapping[str, ZooFact]
    proof: ZooProof | None = None

    @property
    def level(self) -> Level:
        """Its level of proof."""
        return levels()[0 if self.proof is None else self.proof["level"]]

    @property
    def gates(self) -> Sequence[GateProof]:
        """The gates that judged it."""
        return () if self.proof is None else self.proof["gates"][: self.proof["level"]]

    @property
    def outcome(self) -> str | None:
        """The outcome of the gates, in a few words; None without any."""
        if self.proof is None:
            return None
        failed, silent = (
            sum(len(gate["failed"]) for gate in self.gates),
            sum(len(gate["not_run"]) for gate in self.gates),
        )
        outcome = f"{_rules(failed)} failed" if failed else "nothing wrong"
        return f"{outcome}, {_rules(silent)} could not run" if silent else outcome

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
        """Its family; None if unknown."""
        family: str | None = self.facts["family"].value
        return family


def _rules(number: int) -> str:
    return f"{number} rule{'' if number == 1 else 's'}"


def folder() -> Path:
    """Return the folder of the zoo."""
    return content_folder("spec") / "zoo"


def proof_path(name: str) -> Path:
    """Return the path of a policy's proof."""
    return folder() / "proofs" / f"{name}.json"


@cache
def levels() -> tuple[Level, ...]:
    """Return the levels, lowest first."""
    return tuple(Level(number, **entry) for number, entry in enumerate(_vocabulary()["levels"]))


@cache
def schema(name: str) -> dict[str, Any]:
    """Return the schema of a file of the zoo: `policy` or `proof`."""
    read: dict[str, Any] = json_text.parse((folder() / f"{name}.schema.json").read_bytes())
    return read


@cache
def fact_names() -> tuple[str, ...]:
    """Return the names of all facts, in their order."""
    properties = schema("policy")["properties"]
    return tuple(name for name, entry in properties.items() if entry.get("$ref") == "#/$defs/fact")


@cache
def policies() -> tuple[ZooPolicy, ...]:
    """Return every policy, sorted by name without regard to case."""
    paths = sorted((folder() / "policies").glob("*.yml"), key=lambda path: (path.stem.lower(), path.stem))
    return tuple(_policy(path.stem) for path in paths)


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
    """Return the titles of all families by name."""
    titles: dict[str, str] = _vocabulary()["families"]
    return titles


@cache
def _vocabulary() -> dict[str, Any]:
    vocabulary: dict[str, Any] = spec.read_yaml(folder() / "words.yml")
    return vocabulary


def _policy(name: str) -> ZooPolicy:
    entry = spec.read_yaml(folder() / "policies" / f"{name}.yml")
    path = proof_path(name)
    proof: ZooProof | None = json_text.parse(path.read_bytes()) if path.is_file() else None
    facts = {
        key: ZooFact(**entry[key]) if key in entry else ZooFact(unknown=entry["otherwise"]) for key in fact_names()
    }
    for key, manifest_key in _READ.items():
        read = None if proof is None else proof["read"].get(manifest_key)
        if read is not None and facts[key].value is None:
            facts[key] = ZooFact(read["value"], f"manifest, {read['source']}", note=facts[key].note)
    return ZooPolicy(entry["name"], entry["title"], entry["in_paper"], facts, proof)
