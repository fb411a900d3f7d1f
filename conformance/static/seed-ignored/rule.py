"""XPL118: The run's seed is used, 0 included."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ConfigRead, ModelClass
from xpl_cli.audit.static.sampling import draws
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, dotted, last, targets

_SEED = sdk.Deploy.SEED
_GLOBAL = ("np.random.", "numpy.random.", "random.")
_TENSORS = frozenset(
    ("randn", "rand", "randint", "randperm", "normal", "randn_like", "rand_like", "multinomial", "bernoulli")
)
_SEEDED = frozenset(("default_rng", "RandomState", "Generator", "Random", _SEED, "manual_seed", "SeedSequence"))


@rule(code="XPL118", requirement="XPL-CFG-2")
def seed_ignored(source: Source) -> Iterator[Finding]:
    """The run's seed has no effect, or seed 0 is replaced.

    ## What it does
    Finds truth tests of the seed (`seed or 42`, `if seed:`), seeds that are stored and never used, and actions that are
    sampled from a global generator without any use of a seed; also a seed that is read under a key which neither
    deploy.yml nor a script sets. It is a warning if no code of the adapter names a seed,
    and the code that it wraps draws numbers in a function that infers (`torch.randn` in `predict_action`): the
    configured model may take another path.

    ## Why it matters
    0 is the first seed of every benchmark. `0 or 42` is 42, so that run differs from its label. If the seed is not
    used, no result can be reproduced.

    ## Example
    `self.seed = int(config.get("seed") or 6198)`.

    ## Use instead
    `self.seed` and `self.rng(env)` of `xpl.Policy`; otherwise `0 if seed is None else seed`, and a generator of the
    adapter's own.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    seed_reads = [setting for setting in adapter.settings if setting.read.key == _SEED]
    for setting in seed_reads:
        yield from _replaced(source, setting)
    if seed_reads and not adapter.config_escapes and not adapter.is_sdk:
        yield from _unused(source, adapter, seed_reads)
    if not seed_reads:
        misnamed = list(_misnamed(source, adapter))
        yield from misnamed or _unseeded(source, adapter)


def _replaced(source: Source, setting: ConfigRead) -> Iterator[Finding]:
    """Yield the truth test that a read of the seed stands in, as it is or by its name in the same function."""
    function = setting.function
    node: ast.AST = setting.read.node
    parent = function.up.get(node)
    while isinstance(parent, ast.Call) and called(parent) in {"int", "str"}:
        node, parent = parent, function.up.get(parent)
    stored = {ast.unparse(target) for target in targets(parent)} if isinstance(parent, ast.Assign) else set()
    for test in function.nodes:
        replaced: ast.expr | None = None
        if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.Or):
            before = test.values[:-1]
            instead = constant(test.values[-1])
            if (node in before or any(ast.unparse(value) in stored for value in before)) and instead not in (None, 0):
                replaced = test
        elif isinstance(test, (ast.IfExp, ast.If)) and (test.test is node or ast.unparse(test.test) in stored):
            replaced = test.test if isinstance(test, ast.If) else test
        if replaced is not None:
            yield Finding(
                "seed 0, the first seed of every benchmark, is treated as missing and is replaced or ignored",
                **source.at(function.file, replaced),
                expected="0 is a seed like any other",
                got=ast.unparse(replaced),
                fix=Fix("advice", "test for None: `default if seed is None else seed`"),
            )
            return


def _unused(source: Source, adapter: ModelClass, seed_reads: list[ConfigRead]) -> Iterator[Finding]:
    """Yield a seed that is only stored: in an attribute or a name that nothing reads."""
    functions = adapter.reach(*adapter.methods)
    for setting in seed_reads:
        function = setting.function
        statement: ast.AST | None = setting.read.node
        while statement is not None and not isinstance(statement, ast.stmt):
            statement = function.up.get(statement)
        if not isinstance(statement, (ast.Assign, ast.AnnAssign)):
            return
        for target in targets(statement):
            name = last(ast.unparse(target))  # an attribute may be reached by another path than it was set by
            where = functions if isinstance(target, ast.Attribute) else [function]
            kind = ast.Attribute if isinstance(target, ast.Attribute) else ast.Name
            mentions = (node for other in where for node in other.nodes if isinstance(node, kind))
            if any(isinstance(node.ctx, ast.Load) and last(ast.unparse(node)) == name for node in mentions):
                return
    setting = seed_reads[0]
    yield Finding(
        "the seed is stored and never used: runs with different seeds are equal, or no run can be reproduced",
        **source.at(setting.function.file, setting.read.node),
        expected="a generator seeded with it",
        got="stored, never read",
        fix=Fix("advice", "seed the policy's generator with it; xpl.Policy provides self.rng(env)"),
    )


def _misnamed(source: Source, adapter: ModelClass) -> Iterator[Finding]:
    """Yield a seed that is read under another name than the one by which runs give it."""
    scripts = "\n".join(source.text(name) for name in source.text_files if name.endswith(".sh"))
    for setting in adapter.settings:
        key = str(setting.read.key)
        if _SEED in key.lower().split("_") and key not in source.deploy and not re.search(rf"\b{key}=", scripts):
            yield Finding(
                f"{key} is read, which nothing sets, and {_SEED}, which launchers set, is not: all runs are equal",
                **source.at(setting.function.file, setting.read.node),
                expected=_SEED,
                got=key,
                fix=Fix("advice", f"read {_SEED}"),
            )
            return


def _unseeded(source: Source, adapter: ModelClass) -> Iterator[Finding]:
    """Yield a random number that is drawn from a global generator in an adapter that never mentions a seed."""
    functions = adapter.reach(*OBSERVING, *ACTING)
    if any(_mentions_seed(source, file) for file in {adapter.file, *(function.file for function in functions)}):
        return
    for function in functions:
        for node in function.nodes:
            name = called(node)
            drawn = name.startswith(_GLOBAL) or (name.startswith("torch.") and last(name) in _TENSORS)
            if drawn and last(name) not in _SEEDED and isinstance(node, ast.Call):
                if any(keyword.arg == "generator" for keyword in node.keywords):
                    continue
                yield Finding(
                    f"actions depend on {name}, which is not seeded: equal seeds give different episodes",
                    **source.at(function.file, node),
                    expected="random numbers from a generator that the run seed determines",
                    got=ast.unparse(node),
                    fix=Fix("advice", "draw from self.rng(env) of xpl.Policy, or from a generator made from the seed"),
                )
                return
    drawn_in = None if adapter.is_sdk or adapter.config_escapes else next(draws(source), None)
    if drawn_in is not None:
        yield Finding(
            f"no code of the adapter reads the seed, and what it wraps samples (as {drawn_in.text}): no run repeats",
            path=drawn_in.file,
            line=drawn_in.line,
            column=1,
            expected="random numbers that the run seed determines",
            got=drawn_in.text,
            fix=Fix("advice", "seed the generators at the start of every episode from the configuration's seed"),
            must=False,
        )


def _mentions_seed(source: Source, file: str) -> bool:
    return any(
        _SEED in part.lower()
        for node in source.nodes(file)
        for part in (dotted(node), getattr(node, "arg", None) or "")
        if isinstance(part, str)
    )
