"""What the zoo knows of an adapter's policy: it answers what neither the adapter's files nor a checkpoint say.

An adapter is a policy's if it is called like it, and wraps no other code.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.facts import Evidence, Told, likely
from xpl_cli.standard import spec
from xpl_cli.standard.zoo import policies

if TYPE_CHECKING:
    from collections.abc import Iterator

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


def facts(policy: Policy) -> Iterator[tuple[str, Told]]:
    """Yield keys of the manifest with what is known of a policy, each with its source."""
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


def _fact(policy: Policy, key: str, value: object, *sources: str) -> tuple[str, Told]:
    where = (f"xpl zoo show {policy.name} ({name}: {policy.facts[name].source})" for name in sources)
    return key, likely(value, *(Evidence("", None, place) for place in where))


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _place(repository: str) -> str:
    """Return where a repository is, however its address is written."""
    return repository.lower().removesuffix("/").removesuffix(".git").partition("://")[2]
