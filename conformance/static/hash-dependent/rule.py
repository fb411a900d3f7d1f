"""XPL184: Nothing depends on the hash of a text or the time of day."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, LOADING, OBSERVING, RESETTING, Adapter
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, enclosing, last

_SEEDS: Final = re.compile(
    r"(manual_)?seed(_all|_everything)?|default_rng|RandomState|Random|PRNGKey|set_seed|Generator"
)
_CLOCKS: Final = frozenset(
    ("time.time", "time.time_ns", "os.getpid", "time.perf_counter", "datetime.now", "os.urandom")
)


@rule(code="XPL184", requirement="XPL-CFG-2")
def hash_dependent(source: Source) -> Iterator[Finding]:
    """A seed or an order comes from the hash of a text, the time or the process, and is another one in the next run.

    ## What it does
    Looks in what the class reaches for seeds made of `hash(...)`, of the time or of the process, and for lists made of
    a set without `sorted`, whose entries are taken by place.

    ## Why it matters
    Python hashes texts differently in each process. Equal run seeds then give other actions, and joints or cameras that
    came through a set stand in another order: each start of the server is another policy.

    ## Example
    `torch.manual_seed(hash(task_name))`, `cameras = list(set(names))`.

    ## Use instead
    `self.rng(env)` of `xpl.Policy`; `zlib.crc32(text.encode())` for a number from a text; `sorted(set(names))` or
    `dict.fromkeys(names)`.

    ## Fix safety
    No automatic fix.
    """
    for function in Adapter.of(source).reach(*LOADING, *OBSERVING, *ACTING, *RESETTING):
        for call in function.of(ast.Call):
            told = _told(call, function)
            if told is not None:
                message, expected = told
                yield Finding(
                    message,
                    **source.at(function.file, call),
                    expected=expected,
                    got=ast.unparse(call)[:80],
                    fix=Fix("advice", expected),
                )


def _told(call: ast.Call, function: Function) -> tuple[str, str] | None:
    name = called(call)
    if name == "hash" or name in _CLOCKS:
        around = (last(called(entry)) for entry in enclosing(call, function.up) if isinstance(entry, ast.Call))
        if any(_SEEDS.fullmatch(entry) for entry in around):
            return f"the seed comes from {name}: equal runs act differently", "a seed made of the run's seed alone"
    if name in {"list", "tuple"} and len(call.args) == 1 and _is_set(call.args[0]):
        return "the order of a set is another one in each process: so is the policy", "sorted(...), or dict.fromkeys"
    return None


def _is_set(node: ast.expr) -> bool:
    if isinstance(node, (ast.Set, ast.SetComp)):
        return True
    return called(node) in {"set", "frozenset"}
