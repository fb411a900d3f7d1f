"""XPL160: Scripts use the arguments that launchers give them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Final

from xpl._spec import Deploy, File
from xpl_cli.audit import Finding, Fix, Location, NotApplicable, rule
from xpl_cli.audit.static.scripts.flow import only_prints, word_location
from xpl_cli.audit.static.shell import ShellWord
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec

_CONSEQUENCES: Final = {
    Deploy.TASK_NAME: "every task is evaluated as the same one",
    Deploy.CKPT_NAME: "every checkpoint name runs the same weights",
    Deploy.ENV_CFG_TYPE: "every robot is served as the same one",
    Deploy.ACTION_TYPE: "every action type is served as the same one",
    Deploy.SEED: "runs with different seeds are the same run",
    Deploy.GPU_ID: "training runs on the first GPU",
    Deploy.PORT: "the client connects to the wrong server",
    Deploy.HOST: "a client on another machine cannot connect",
    "policy_gpu_id": "the model runs on the first GPU",
    "env_gpu_id": "the simulator runs on the first GPU",
    "policy_env": "the model runs in the first Python on the path",
    "eval_env": "the simulator runs in the first Python on the path",
}
_BOTH: Final = frozenset((Deploy.ENV_CFG_TYPE, Deploy.SEED, Deploy.PORT))
_SERVED: Final = _BOTH | {Deploy.CKPT_NAME, Deploy.ACTION_TYPE, "policy_gpu_id", "policy_env"}
_CALLED: Final = _BOTH | {Deploy.TASK_NAME, "env_gpu_id", "eval_env"}
_DECISIVE: Final = {
    File.EVAL_SH: _SERVED | _CALLED,
    File.SETUP_EVAL_POLICY_SERVER_SH: _SERVED | {Deploy.HOST},
    File.SETUP_EVAL_ENV_CLIENT_SH: _CALLED,
    File.TRAIN_SH: frozenset((Deploy.SEED, Deploy.GPU_ID)),
}
"""The arguments of each script that nothing else brings to where they are needed."""

_REST: Final = re.compile(r"\$\{[@*]:(\d+)")
"""All arguments from one on."""
_EXPANSION: Final = re.compile(r"\$(?:\{[#!]?(\w+|[@*](?!:\d))|(\d|[A-Za-z_]\w*|[@*]))")

_SAYS = frozenset(("", ":", "[", "[[", "cat", "echo", "exit", "printf", "return", "set", "true"))
"""What a stub is made of; assignments have no name."""


@rule(code="XPL160", requirement="XPL-PKG-2")
def ignored_argument(source: Source) -> Iterator[Finding]:
    """A script ignores an argument that launchers give it.

    ## What it does
    Follows each argument of the standard through its script: into the variable that holds it, and from there into
    commands. An argument that no variable takes, or that is only printed and tested, has no effect; an optional one
    need not be taken. Not reported: scripts that pass on all arguments (`"$@"`), or all from this one on (`"${@:7}"`),
    or iterate over them (`shift`), and stubs that only print that there is nothing to do.

    ## Why it matters
    The run differs from the launcher's label: ten seeds give one result ten times, two policies share a GPU, or another
    checkpoint than the named one is evaluated.

    ## Example
    `seed=$6` in `setup_eval_policy_server.sh`, and a call of the server without it.

    ## Use instead
    Pass the argument on: `--overrides seed="${seed}"`, `CUDA_VISIBLE_DEVICES="${policy_gpu_id}"`.

    ## Fix safety
    No automatic fix: the right place for the argument depends on the program.
    """
    has_finding = False
    orders = spec.data("package")["scripts"]
    for name, decisive in _DECISIVE.items():
        if source.has(name):
            has_finding = True
            yield from _ignored(source, name, orders[name], decisive)
    if not has_finding:
        raise NotApplicable("the adapter has no scripts of the standard")


def _ignored(source: Source, name: str, order: list[str], decisive: frozenset[str]) -> Iterator[Finding]:
    # Counted in the text: what a here-document holds is handed on too.
    lines = [line for line in source.text(name).split("\n") if not line.lstrip().startswith("#")]
    mentions = _expanded(lines)
    rest = min((int(first) for line in lines for first in _REST.findall(line)), default=len(order) + 1)
    commands = source.commands(name)
    is_stub = all(command.name in _SAYS for command in commands)
    if is_stub or mentions["@"] or mentions["*"] or any(command.name == "shift" for command in commands):
        return
    spoken = _expanded(word.raw for command in commands if only_prints(command) for word in command.words)
    taken: dict[str, list[tuple[str, ShellWord]]] = {}
    for command in commands:
        for variable, word in () if command.functions else command.assignments:
            for item in word.expansions:
                if item.name.isdigit():
                    taken.setdefault(item.name, []).append((variable, word))
    for number, entry in enumerate(order, start=1):
        argument = entry.strip("[]")
        if argument not in decisive or number >= rest:
            continue
        into = taken.get(str(number), [])
        if not into and not mentions[str(number)] and argument == entry:
            yield _finding(name, argument, None, f"no ${number}")
        elif into and all(mentions[variable] == spoken[variable] for variable, _ in into):
            variable, word = into[0]
            yield _finding(name, argument, word_location(name, word), f"{variable}={word.raw}, and no use of it")


def _expanded(texts: Iterable[str]) -> Counter[str]:
    """Count the places where the shell, or a shell that gets the text, puts in the value of each variable."""
    return Counter(first or second for first, second in _EXPANSION.findall("\n".join(texts)))


def _finding(name: str, argument: str, at: Location | None, got: str) -> Finding:
    return Finding(
        f"{name} ignores {argument}: {_CONSEQUENCES[argument]}",
        **(at or {"path": name, "line": 1, "column": 1}),
        expected=f"{argument} passed on to the programs of {name}",
        got=got,
        fix=Fix("advice", f"hand {argument} on"),
    )
