"""Evidence that the code which an adapter wraps draws random numbers during inference."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, Final, NamedTuple

from xpl_cli.audit.static import vendored

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.static.source import Source

_DRAW: Final = re.compile(
    r"\b(?:torch\.(?:randn|rand|normal|randn_like|rand_like)|(?:np|numpy)\.random\.(?:randn|normal|standard_normal))\("
)
_DEFINITION: Final = re.compile(r"^[ \t]*(?:async )?def (\w+)\(", re.MULTILINE)
_INFERENCE: Final = re.compile(
    r"predict|infer(?!_dim)|denois|(?:get|select|sample|generate)_actions?|sample_(?:init_)?noise|conditional_sample"
    r"|condition_sample",
    re.IGNORECASE,
)
_OTHER: Final = re.compile(r"train|loss|mask|test|dummy|video|debug|bench", re.IGNORECASE)
_ELSEWHERE: Final = re.compile(r"(?:^|/)(?:tests?|train\w*|data\w*|scripts?|benchmarks?|tools|process_data\.py)(?:/|$)")
_LIBRARY: Final = re.compile(
    r"lerobot\.(?:common\.)?policies\.(?:pi0|pi05|smolvla|diffusion|groot|xvla|wall_x|multi_task_dit|eo1|evo1)\b"
)
"""Policies of LeRobot that denoise what they draw: those of flow matching and diffusion."""
_WIDEST: Final = 400
"""Characters of a call's arguments that are read."""


class Draw(NamedTuple):
    """A call, or an import of a policy that makes such calls.

    Attributes:
        file: its file.
        line: its line.
        text: as it is named in a finding.
    """

    file: str
    line: int
    text: str


def draws(source: Source) -> Iterator[Draw]:
    """Yield draws from a global generator in functions that infer, and imports of policies that make some."""
    for name in source.python_files:
        if source.parses(name) and not _ELSEWHERE.search(name):
            yield from _in_text(name, source.text(name))
            for node in source.nodes(name):
                modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                for module in modules:
                    if _LIBRARY.match(module):
                        yield Draw(name, getattr(node, "lineno", 1), module)
    for name, text in vendored.texts(source):
        if name.endswith(".py") and not _ELSEWHERE.search(name):
            yield from _in_text(name, text)


def _in_text(name: str, text: str) -> Iterator[Draw]:
    for match in _DRAW.finditer(text):
        before = text[: match.start()]
        if before.rpartition("\n")[2].lstrip().startswith("#") or _is_seeded(text, match.end()):
            continue
        function = next((found[1] for found in reversed(list(_DEFINITION.finditer(before)))), "")
        if _INFERENCE.search(function) and not _OTHER.search(function):
            yield Draw(name, before.count("\n") + 1, f"{match[0][:-1]} in {function}")


def _is_seeded(text: str, start: int) -> bool:
    """Tell whether a call gets a generator that its function does not leave None."""
    arguments = _arguments(text[start : start + _WIDEST])
    return "generator" in arguments and not re.search(r"generator\b[^=,\n]*=\s*None", text)


def _arguments(text: str) -> str:
    open_brackets = 1
    for place, letter in enumerate(text):
        open_brackets += (letter in "([{") - (letter in ")]}")
        if not open_brackets:
            return text[:place]
    return text
