"""Facts of the zoo about an adapter's policy, for what neither its files nor a checkpoint state.

An adapter belongs to a policy of the zoo if it has its name and wraps no other code.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.facts import Evidence, Fact, likely
from xpl_cli.standard import spec
from xpl_cli.standard.zoo import policies

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.standard.zoo.policies import ZooPolicy

_ARXIV: Final = "https://arxiv.org/abs/"


def find_policy(name: str, repository: str | None = None) -> ZooPolicy | None:
    """Return the policy of the zoo that has an adapter's name; None if there is none.

    Args:
        name: of the adapter's folder.
        repository: the code that it wraps, if known; a policy of the same name with other code does not match.
    """
    policy = next((one for one in policies.policies() if _plain(one.name) == _plain(name)), None)
    code = None if policy is None else policy.facts["code"].value
    return None if code and repository and _normalised_address(code) != _normalised_address(repository) else policy


def facts(policy: ZooPolicy) -> Iterator[tuple[str, Fact]]:
    """Yield keys of the manifest with the facts of a policy."""
    values = policy.facts
    families = spec.schema("policy")["properties"]["family"]["enum"]
    if values["family"].value in families:
        yield _fact(policy, "family", values["family"].value, "family")
    if (paper := values["paper"].value) is not None:
        number = {"url": f"{_ARXIV}{paper['arxiv']}", "arxiv": paper["arxiv"]} if paper["arxiv"] else {}
        yield _fact(policy, "paper", {"title": paper["title"], **number}, "paper")
    if values["code"].value is not None:
        upstream = {"repository": values["code"].value, "revision": values["revision"].value}
        license_ = {"license": values["license"].value} if values["license"].value else {}
        yield _fact(policy, "upstream", {**upstream, **license_}, "code", *license_)
    if values["chunk"].value is not None and values["chunk"].value == values["executed"].value:
        yield _fact(policy, "temporal.chunk", values["chunk"].value, "chunk")  # else an adapter may return either


def _fact(policy: ZooPolicy, key: str, value: object, *sources: str) -> tuple[str, Fact]:
    where = (f"xpl zoo show {policy.name} ({name}: {policy.facts[name].source})" for name in sources)
    return key, likely(value, *(Evidence("", None, source) for source in where))


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _normalised_address(repository: str) -> str:
    """Return a repository's address without scheme and `.git`, in lower case."""
    return repository.lower().removesuffix("/").removesuffix(".git").partition("://")[2]
