"""Which process runs which tests: those of a file together, so that what a file makes once is made once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from xdist.scheduler import LoadFileScheduling

if TYPE_CHECKING:
    import pytest

_LONG: Final = (
    "audit/test_conformance.py",
    "project/test_github_action.py",
    "project/test_packaging.py",
    "submission/test_verification.py",
    "scaffold/test_new_env.py",
    "audit/offline/test_replay.py",
    "scaffold/test_update.py",
    "client/interop/test_inspect_robots.py",
    "audit/static/test_robustness.py",
    "environments/benchmarks/test_metaworld.py",
    "sdk/test_limits.py",
    "serving/test_chaos.py",
    "docs/test_site.py",
    "commands/test_demo.py",
)
"""Files that take longest. They come first: one that began last would be waited for by all the others."""

_WIDE: Final = frozenset({"tests/audit/test_conformance.py"})
"""Files of many tests that share nothing, which several processes may run."""
_PARTS: Final = 8


def order(items: list[pytest.Item]) -> None:
    """Put what takes longest first; the rest stays as it is."""
    ranks = {f"tests/{name}": rank for rank, name in enumerate(_LONG)}
    items.sort(key=lambda item: ranks.get(item.nodeid.partition("::")[0], len(ranks)))


class ByFile(LoadFileScheduling):
    """Gives whole files to processes, in the order in which they were found."""

    def __init__(self, config: Any, log: Any = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False  # it would put the files with most tests first

    def _split_scope(self, nodeid: str) -> str:
        file: str = super()._split_scope(nodeid)
        return f"{file}::{sum(nodeid.encode()) % _PARTS}" if file in _WIDE else file
