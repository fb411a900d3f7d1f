"""XPL196: The adapter reads the instruction, in both spellings."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.episode_state import is_reported
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, ModelClass
from xpl_cli.audit.static.observation_flow import escapes
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, key_read, last, targets, texts

_ONE, _MANY = sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS
_SPOKEN: Final = re.compile(r"(?:^|_)(?:lang|language|prompts?|instructions?)(?:_|$)", re.IGNORECASE)
_LANGUAGE: Final = re.compile(r"embed|encode|token|lang|text|clip|bert|t5|sentence", re.IGNORECASE)
"""Names of functions that make an input of a text."""
_READS_BOTH: Final = "get_instruction"
_WORDS: Final = 4


@rule(code="XPL196", requirement="XPL-OBS-4")
def instruction_unread(source: Source) -> Iterator[Finding]:
    """The adapter does not read the instruction of an observation, or reads one spelling only.

    ## What it does
    Looks at which of `instruction` and `instructions` the functions reached from `update_obs` and `get_action` read. It
    reports an adapter that reads one spelling only, and one that reads neither and follows a sentence from its code, or
    the name of the task in its configuration. It
    warns if a policy with another language input reads neither, since its weights may know one task only, and if the
    code has a whole sentence, or the name of the task, as a fallback for the instruction. Not reported: adapters that
    pass the whole observation on to another package.

    ## Why it matters
    Both spellings occur in practice. A policy that does not know the spelling that it gets stops, or uses a default: it
    moves, and follows an instruction that the user did not give.

    ## Example
    `prompt = obs.get("instruction", self.default_prompt)`: an observation with `instructions` gets the default.

    ## Use instead
    `xpl.observation.get_instruction(obs, required=True)`, which also raises an error if there is none.

    ## Fix safety
    Safe: reading the other spelling too does not affect observations that were read before.
    """
    adapter = ModelClass.of(source)
    if adapter.is_sdk and not {"encode", *sdk.CONTRACT_METHODS[:2]} & set(adapter.methods):
        raise NotApplicable("the base class reads the instruction")
    functions = adapter.reach(*OBSERVING, *ACTING)
    reads_both = any(last(called(node)) == _READS_BOTH for function in functions for node in function.of(ast.Call))
    may_be_read = reads_both or escapes(adapter)
    mentioned = {text for function in functions for text in _constants(function)}
    is_unread = not may_be_read and not mentioned & {_ONE, _MANY}
    sentences = list(_sentences(source, adapter, is_unread=is_unread))
    yield from sentences
    yield from _names_of_tasks(source, functions)
    followed = _followed_task(adapter) if is_unread and not sentences else None
    if followed is not None:
        function, call = followed
        yield Finding(
            "the policy never reads the instruction of an observation: it follows the name of the task in its "
            "configuration, whatever an environment says",
            **source.at(function.file, call),
            expected=f"`{_ONE}` of the observation",
            got=ast.unparse(call)[:80],
            fix=Fix("advice", "read it with xpl.observation.get_instruction(obs, required=True)"),
        )
        return
    if may_be_read or (is_unread and sentences):
        return
    read = [(function, node) for function in functions for node in _reads(function)]
    if read and len(mentioned & {_ONE, _MANY}) == 1:
        (spelling,) = mentioned & {_ONE, _MANY}
        other = _MANY if spelling == _ONE else _ONE
        function, node = read[0]
        yield Finding(
            f"an observation with `{other}` is not read, only one with `{spelling}`: the policy stops there, or "
            "follows a default",
            **source.at(function.file, node),
            expected=f"`{_ONE}`, or the first of `{_MANY}`",
            got=ast.unparse(node)[:80],
            fix=Fix("advice", "read it with xpl.observation.get_instruction(obs, required=True)"),
        )
    elif not mentioned & {_ONE, _MANY}:
        spoken = next(_spoken(adapter), None)
        if spoken is not None:
            function, instruction_node, name = spoken
            yield Finding(
                f"the policy has the input {name}, but never reads the instruction of an observation: every "
                "instruction gives the same action; its weights may know one task only",
                **source.at(function.file, instruction_node),
                expected=f"`{_ONE}` of the observation",
                got=ast.unparse(instruction_node).split("\n")[0][:80],
                fix=Fix("advice", "read it with xpl.observation.get_instruction(obs, required=True)"),
                must=False,
            )


def _reads(function: Function) -> Iterator[ast.expr]:
    """Yield where an instruction is read, under its name or one of several in a row."""
    for node in function.of(ast.Subscript, ast.Call):
        read = key_read(node)
        if read is not None and read.key in {_ONE, _MANY}:
            yield read.node
    loops: list[ast.For | ast.comprehension] = [*function.of(ast.For), *function.of(ast.comprehension)]
    for loop in loops:
        if {_ONE, _MANY} & texts(loop.iter):
            yield loop.iter


def _followed_task(adapter: ModelClass) -> tuple[Function, ast.Call] | None:
    """Return where the name of the task, from the configuration, is made an input of language."""
    reads = {id(setting.read.node) for setting in adapter.settings if setting.read.key == sdk.Deploy.TASK_NAME}
    for function in adapter.reach(*adapter.methods):
        for call in function.of(ast.Call):
            is_language = _LANGUAGE.search(called(call)) is not None
            if is_language and any(id(child) in reads for argument in call.args for child in ast.walk(argument)):
                return function, call
    return None


def _names_of_tasks(source: Source, functions: list[Function]) -> Iterator[Finding]:
    """Yield the name of the task in place of an instruction that is missing."""
    for function in functions:
        for node in (*function.of(ast.Call), *function.of(ast.BoolOp)):
            fallbacks: list[ast.expr] = []
            if isinstance(node, ast.BoolOp):
                fallbacks = node.values[1:] if {_ONE, _MANY} & texts(node.values[0]) else []
            elif (read := key_read(node)) is not None and read.key in {_ONE, _MANY} and read.default is not None:
                fallbacks = [read.default]
            named = (
                child
                for one in fallbacks
                for child in ast.walk(one)
                if sdk.Deploy.TASK_NAME
                in (getattr(child, "value", ""), getattr(child, "attr", ""), getattr(child, "id", ""))
            )
            if next(named, None) is not None:
                yield Finding(
                    "without an instruction the policy follows the name of the task, which no weights were trained on",
                    **source.at(function.file, node),
                    expected="an error if there is no instruction",
                    got=ast.unparse(node)[:80],
                    fix=Fix("advice", "read it with xpl.observation.get_instruction(obs, required=True)"),
                    must=False,
                )
                return


def _constants(function: Function) -> set[str]:
    """Return the texts of a function, other than the keys of maps that it makes."""
    written = {id(key) for node in function.of(ast.Dict) for key in node.keys}
    return {
        node.value
        for node in function.of(ast.Constant)
        if isinstance(node.value, str) and id(node) not in written and not is_reported(node, function)
    }


def _spoken(adapter: ModelClass) -> Iterator[tuple[Function, ast.expr, str]]:
    """Yield what the model is given that is called language."""
    for function in adapter.reach(*ACTING):
        for call in function.of(ast.Call):
            for keyword in call.keywords:
                if keyword.arg and _SPOKEN.search(keyword.arg):
                    yield function, keyword.value, keyword.arg


def _sentences(source: Source, adapter: ModelClass, *, is_unread: bool) -> Iterator[Finding]:
    """Yield a sentence in the code that a policy follows without an instruction, or always if it never reads one."""
    for function in adapter.reach(*LOADING, *OBSERVING, *ACTING):
        nodes: list[ast.Assign | ast.AnnAssign | ast.Call] = [*function.of(ast.Assign), *function.of(ast.AnnAssign)]
        for node in [*nodes, *function.of(ast.Call)]:
            names = [ast.unparse(target) for target in targets(node)]
            read = key_read(node)
            value = node.value if not isinstance(node, ast.Call) else read.default if read is not None else None
            names += [read.key] if read is not None else []
            if value is None or not any(_SPOKEN.search(last(name)) for name in names):
                continue
            values = value.values if isinstance(value, ast.BoolOp) else [value]
            sentence = constant(values[-1])
            if isinstance(sentence, str) and len(sentence.split()) >= _WORDS and "{" not in sentence:
                yield Finding(
                    "the policy never reads the instruction of an observation: it follows a sentence from the code, "
                    "or from its configuration, whatever task an environment sets"
                    if is_unread
                    else "without an instruction the policy follows a sentence from the code, on every task; that "
                    "may never happen",
                    **source.start(function.file, node),
                    expected=f"`{_ONE}` of the observation" if is_unread else "an error if there is no instruction",
                    got=repr(sentence)[:80],
                    fix=Fix(
                        "advice",
                        "read it with xpl.observation.get_instruction(obs, required=True)"
                        if is_unread
                        else "raise an error if neither the observation nor the configuration has an instruction",
                    ),
                    must=is_unread,
                )
