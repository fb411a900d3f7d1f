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
_HOURS: Final = (
    "model_io/test_mutants.py",
    "environments/test_mujoco.py",
    "environments/test_tasks.py",
    "audit/offline/test_mutation.py",
    "scaffold/test_kinds.py",
)
"""The same, where slow tests run, too: one process would play them for an hour after the others have ended."""
_PARTS: Final = 8


def order(items: list[pytest.Item], *, is_whole: bool) -> None:
    """Put what takes longest first; the rest stays as it is. `is_whole` tells whether slow tests run, too."""
    names = (*_HOURS, *_LONG) if is_whole else _LONG
    ranks = {f"tests/{name}": rank for rank, name in enumerate(names)}
    items.sort(key=lambda item: ranks.get(item.nodeid.partition("::")[0], len(ranks)))


class ByFile(LoadFileScheduling):
    """Gives whole files to processes, in the order in which they were found; wide ones in parts."""

    def __init__(self, config: Any, log: Any = None, *, is_whole: bool = False) -> None:
        super().__init__(config, log)
        self._wide = _WIDE | {f"tests/{name}" for name in _HOURS if is_whole}
        config.option.loadscopereorder = False  # it would put the files with most tests first

    def _split_scope(self, nodeid: str) -> str:
        file: str = super()._split_scope(nodeid)
        return f"{file}::{sum(nodeid.encode()) % _PARTS}" if file in self._wide else file
