"""What the zoo knows of an adapter's policy: facts that answer what the adapter's own files leave open.

An adapter is a policy's if it is called like it, and wraps no other code. One that only wraps the same code may be of
another policy, as many stand on one library: of it only what is said of that code counts.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.adopt.facts import Evidence, Fact, likely
from xpl_cli.standard import spec
from xpl_cli.standard.zoo import policies

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from xpl_cli.standard.zoo.policies import Policy

_ARXIV: Final = "https://arxiv.org/abs/"


def called(name: str, repository: str | None = None) -> Policy | None:
    """Return the policy of the zoo that is called like an adapter.

    Args:
        name: of the adapter's folder.
        repository: code that it wraps, where that is known; a policy of the same name that wraps other code is another.
    """
    found = next((one for one in policies.policies() if _plain(one.name) == _plain(name)), None)
    code = None if found is None else found.facts["code"].value
    return None if code and repository and _place(code) != _place(repository) else found


def facts(policy: Policy) -> Iterator[Fact]:
    """Yield what is known of a policy by keys of the manifest, each with its source."""
    known = policy.facts
    families = spec.schema("policy")["properties"]["family"]["enum"]
    if known["family"].value in families:
        yield _fact(policy, "family", known["family"].value, "family")
    if (paper := known["paper"].value) is not None:
        number = {"url": f"{_ARXIV}{paper['arxiv']}", "arxiv": paper["arxiv"]} if paper["arxiv"] else {}
        yield _fact(policy, "paper", {"title": paper["title"], **number}, "paper")
    if known["code"].value is not None:
        told = {"repository": known["code"].value, "revision": known["revision"].value}
        license_ = {"license": known["license"].value} if known["license"].value else {}
        yield _fact(policy, "upstream", {**told, **license_}, "code", *license_)
    if known["chunk"].value is not None and known["chunk"].value == known["executed"].value:
        yield _fact(policy, "temporal.chunk", known["chunk"].value, "chunk")  # else an adapter may answer either


def completed(fact: Fact, known: Fact) -> Fact:
    """Return a map that was read with what the zoo adds to it, if both say the same as far as both speak."""
    read: Mapping[str, Any] = fact.value
    added = {key: value for key, value in known.value.items() if read.get(key) is None and value is not None}
    if not added or any(read.get(key) not in (None, value) for key, value in known.value.items()):
        return fact
    return Fact(fact.key, {**read, **added}, fact.confidence, (*fact.evidence, *known.evidence))


def licensed(upstream: Fact) -> Fact:
    """Return the fact about the code that an adapter wraps with its licence, if policies of the zoo agree on that."""
    told: Mapping[str, Any] = upstream.value
    same = [one for one in policies.policies() if _place(one.facts["code"].value) == _place(told["repository"])]
    licences = {one.facts["license"].value for one in same}
    if told.get("license") or len(licences) != 1 or None in licences:
        return upstream
    value = {**told, "license": licences.pop()}
    return Fact(upstream.key, value, upstream.confidence, (*upstream.evidence, _evidence(same[0], "license")))


def _fact(policy: Policy, key: str, value: Any, *sources: str) -> Fact:
    return likely(key, value, *(_evidence(policy, source) for source in sources))


def _evidence(policy: Policy, name: str) -> Evidence:
    return Evidence("", None, f"xpl zoo show {policy.name} ({name}: {policy.facts[name].source})")


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _place(repository: str | None) -> str | None:
    """Return where a repository is, however its address is written."""
    if repository is None:
        return None
    return repository.lower().removesuffix("/").removesuffix(".git").partition("://")[2]
