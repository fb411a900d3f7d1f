"""What the model reads of an observation: instruction, state and cameras, and whether it does without."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.adopt.facts import Confidence, Evidence, Fact, Finding, Question, weakest
from xpl_cli.adopt.values import UNKNOWN
from xpl_cli.audit.static.adapter import ACTING, OBSERVING, RESET
from xpl_cli.audit.static.blanks import blanks
from xpl_cli.audit.static.keys import entries
from xpl_cli.audit.static.syntax import called, constant, enclosing, key_read, last, names, parameters
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.adopt.values import Values
    from xpl_cli.audit.static.function import Function

_PACKS: Final = re.compile(r"_*pack(_\w+)?_state")
_LOOKS: Final = re.compile(r"image|camera|rgb|img|frame|view|cam_|color|colour", re.IGNORECASE)
_SIDES: Final = tuple(prefix for prefixes in sdk.ARM_PREFIXES.values() for prefix in prefixes if prefix)
_INSTRUCTIONS: Final = (sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS)


@dataclass(frozen=True)
class Read:
    """One input that is read somewhere.

    Attributes:
        name: as the manifest calls it.
        required: whether the model fails without it.
        confidence: how sure that is.
        evidence: where it is read.
    """

    name: str
    required: bool
    confidence: Confidence
    evidence: Evidence


def inputs(values: Values, kinds: list[str]) -> Iterator[Finding]:
    """Yield what the model reads.

    Args:
        values: the adapter.
        kinds: the kinds of control that it offers, on which it depends which state is packed.
    """
    known = tuple(spec.schema("policy")["$defs"]["input"]["enum"])
    reads = [read for read in (*_instruction(values), *_state(values, kinds), *_cameras(values)) if read.name in known]
    best: dict[str, Read] = {}
    for read in reads:
        other = best.get(read.name)
        if other is None or (read.required, read.confidence == Confidence.CERTAIN) > (
            other.required,
            other.confidence == Confidence.CERTAIN,
        ):
            best[read.name] = read
    if _stands_in(values):
        best = {name: _wanted(read) for name, read in best.items()}
    if not best:
        yield Question("inputs.required", "observation fields that must be there", known)
        return
    for group, wanted in (("required", True), ("optional", False)):
        chosen = [best[name] for name in known if name in best and best[name].required is wanted]
        if chosen or wanted:
            confidence = weakest(read.confidence for read in chosen)
            evidence = tuple(read.evidence for read in chosen)
            yield Fact(
                f"inputs.{group}", [read.name for read in chosen], confidence, evidence, is_itemised=bool(chosen)
            )
    cameras = [name.partition(".")[2] for name in known if name in best and name.startswith(sdk.Obs.VISION)]
    if "cameras" in spec.schema("policy")["properties"]:
        yield from _sizes(values, cameras)


def _stands_in(values: Values) -> bool:
    """Tell whether a black image takes the place of one that is missing: then its absence is no choice, but a fault.

    To call such a camera optional would take that fault out of the audit.
    """
    reached = values.adapter.reach(*OBSERVING, *ACTING)
    return any(blank.is_image and not blank.is_masked for function in reached for blank in blanks(function))


def _wanted(read: Read) -> Read:
    if not read.name.startswith(sdk.Obs.VISION) or read.required:
        return read
    told = replace(read.evidence, what=f"{read.evidence.what}; where it is missing the model sees black")
    return replace(read, required=True, confidence=Confidence.LIKELY, evidence=told)


def _sizes(values: Values, cameras: list[str]) -> Iterator[Finding]:
    """Yield the sizes that images must have: any will do where the code resizes them itself."""
    anything = {"width": None, "height": None}
    resized = next(
        (
            Evidence(function.file, node.lineno, f"{called(node)} makes the size itself")
            for function in values.adapter.reach(*OBSERVING, *ACTING)
            for node in function.of(ast.Call)
            if "resize" in last(called(node)).lower()
        ),
        None,
    )
    if not cameras:
        yield Fact("cameras", {}, Confidence.LIKELY, (Evidence("", None, "no camera is read"),))
    for camera in cameras:
        if resized is not None:
            yield Fact(f"cameras.{camera}", anything, Confidence.LIKELY, (resized,))
        else:
            meaning = "smallest image that the policy can work with; null: any will do"
            yield Question(f"cameras.{camera}", meaning, stand_in=anything)


# -- instruction and state ---------------------------------------------------------------------------------------------


def _instruction(values: Values) -> Iterator[Read]:
    for function in values.adapter.reach(*OBSERVING, *ACTING):
        given = parameters(function.node)
        for node in function.of(ast.Subscript, ast.Call):
            read = key_read(node)
            owner = read.owner if read is not None else _asked(node)
            if not isinstance(owner, ast.Name):
                continue
            if owner.id not in given[:1] and not owner.id.startswith(sdk.Payload.OBS):
                continue
            if read is not None and read.key in _INSTRUCTIONS:
                what = f"reads {ast.unparse(node)[:60]}"
                evidence = Evidence(function.file, node.lineno, what)
                yield Read(sdk.Obs.INSTRUCTION, read.required, Confidence.CERTAIN, evidence)
            elif read is None and (line := _tried(function)) is not None:
                evidence = Evidence(function.file, line, "tries these keys of the observation")
                yield Read(sdk.Obs.INSTRUCTION, required=False, confidence=Confidence.LIKELY, evidence=evidence)


def _asked(node: ast.AST) -> ast.expr | None:
    """Return the map of `map.get(key)` or `map[key]` with a key that is no constant."""
    if isinstance(node, ast.Subscript):
        return node.value if isinstance(node.slice, ast.Name) else None
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get" and node.args:
        return node.func.value
    return None


def _tried(function: Function) -> int | None:
    """Return the line of a loop over names that the instruction may have."""
    for node in function.of(ast.For):
        tried = [constant(part) for part in node.iter.elts] if isinstance(node.iter, (ast.Tuple, ast.List)) else []
        if sdk.Obs.INSTRUCTION in tried:
            return node.lineno
    return None


def _state(values: Values, kinds: list[str]) -> Iterator[Read]:
    types = spec.data("conventions")["action"]["types"]
    packed = [tuple(types[kind]) for kind in kinds if kind in types]
    everywhere = set.intersection(*map(set, packed)) if packed else set()
    for function in values.adapter.reach(*OBSERVING, *ACTING):
        for node in function.of(ast.Call):
            if not _PACKS.fullmatch(last(called(node))) or not node.args or function.name == last(called(node)):
                continue
            happens = _happens(node, function, values)
            evidence = Evidence(function.file, node.lineno, f"{last(called(node))} packs the state")
            for name in dict.fromkeys(name for names_ in packed for name in names_) if happens is not False else ():
                required = name in everywhere and happens is True
                yield Read(f"{sdk.Obs.STATE}.{name}", required, Confidence.LIKELY, evidence)
        for entry in entries(function):
            if entry.group == sdk.Obs.STATE:
                name = next(
                    (entry.name.removeprefix(side) for side in _SIDES if entry.name.startswith(side)), entry.name
                )
                evidence = Evidence(function.file, entry.node.lineno, f"reads {ast.unparse(entry.node)[:60]}")
                required = entry.required and _happens(entry.node, function, values) is True
                yield Read(f"{sdk.Obs.STATE}.{name}", required, Confidence.CERTAIN, evidence)


def _happens(node: ast.AST, function: Function, values: Values) -> bool | None:
    """Tell whether an expression is reached under the adapter's own settings; None if that depends on more."""
    result: bool | None = True
    inner = node
    for outer in enclosing(node, function.up):
        if isinstance(outer, (ast.If, ast.IfExp)) and inner is not outer.test:
            test = values.of(outer.test, function)
            block = outer.body if isinstance(outer.body, list) else [outer.body]
            if test is UNKNOWN:
                result = None
            elif bool(test) is not (inner in block):
                return False
        inner = outer
    return result


# -- cameras -----------------------------------------------------------------------------------------------------------


def _cameras(values: Values) -> Iterator[Read]:
    prefix = f"{sdk.Obs.VISION}."
    named = spec.schema("policy")["$defs"]["input"]["enum"]
    known = tuple(name.removeprefix(prefix) for name in named if name.startswith(prefix))
    looking = [f for f in values.adapter.reach(*OBSERVING, *ACTING) if not f.name.startswith(RESET)]
    for function in looking:
        yield from _taken(function, values, known)
        for file, node in _lists(function, values):
            for texts in _alternatives(node):
                evidence = Evidence(file, node.lineno, f"names {', '.join(texts[:4])}")
                yield from _listed(texts, known, evidence, required=_demands(function, values))
    for setting in values.adapter.settings:
        value = values.source.deploy.get(setting.read.key)
        if isinstance(value, list) and all(isinstance(name, str) for name in value):
            values.trail = []
            values.setting(setting.read, setting.function)
            using = [function for function in looking if _mentions(function, _holders(setting.read.node, values))]
            required = bool(using) and any(_demands(function, values) for function in using)
            yield from _listed(value, known, values.trail[-1], required=required)


def _demands(function: Function, values: Values) -> bool:
    """Tell whether a function raises where a camera that it looks for is not there: itself, or by who looks for it."""
    called_ = [
        callee for call in function.of(ast.Call) if (callee := values.adapter.callee(function, call)) is not None
    ]
    finders = [callee for callee in called_ if sdk.Obs.VISION in names(callee.node)]
    finders = finders or [callee for callee in called_ if _LOOKS.search(callee.name) and "extract" in callee.name]
    return all(map(_fails, finders or [function]))


def _holders(read: ast.expr, values: Values) -> set[str]:
    """Return the attributes of the model that hold what was read."""
    return {
        name
        for name, places in values.attributes.items()
        for _, value in places
        if any(n is read for n in ast.walk(value))
    }


def _mentions(function: Function, attributes: set[str]) -> bool:
    return any(node.attr in attributes for node in function.of(ast.Attribute))


def _taken(function: Function, values: Values, known: tuple[str, ...]) -> Iterator[Read]:
    """Yield the cameras that are read by their names: `vision["cam_head"]`."""
    for node in function.of(ast.Subscript, ast.Call):
        read = key_read(node)
        if read is not None and read.key in known and _is_vision(read.owner, function):
            evidence = Evidence(function.file, node.lineno, f"reads {ast.unparse(node)[:60]}")
            required = read.required and _happens(node, function, values) is True
            yield Read(f"{sdk.Obs.VISION}.{read.key}", required, Confidence.CERTAIN, evidence)
        elif isinstance(node, ast.Call) and read is None:
            for part in node.args:
                name = constant(part)
                if name in known and _LOOKS.search(last(called(node))):
                    callee = values.adapter.callee(function, node)
                    evidence = Evidence(function.file, node.lineno, f"{ast.unparse(node)[:60]}")
                    required = callee is not None and _fails(callee)
                    yield Read(f"{sdk.Obs.VISION}.{name}", required, Confidence.LIKELY, evidence)


def _is_vision(node: ast.expr, function: Function) -> bool:
    if sdk.Obs.VISION in ast.unparse(node):
        return True
    assigned = [n.value for n in function.of(ast.Assign) if isinstance(node, ast.Name) and node.id in _targets(n)]
    return any(sdk.Obs.VISION in ast.unparse(value) for value in assigned)


def _targets(node: ast.Assign) -> set[str]:
    return {target.id for target in node.targets if isinstance(target, ast.Name)}


def _lists(function: Function, values: Values) -> Iterator[tuple[str, ast.expr]]:
    """Yield the lists of names that a function holds, or means by the name of a constant or of an attribute."""
    for node in function.of(ast.Tuple, ast.List, ast.Dict):
        if not isinstance(function.up.get(node), (ast.Tuple, ast.List, ast.Dict)):
            yield function.file, node
    for name in sorted(names(function.node)):
        module = values.module_constant(function.file, name)
        if module is not None and isinstance(module.value, (ast.Tuple, ast.List, ast.Dict)):
            yield function.file, module.value
    for name in sorted({node.attr for node in function.of(ast.Attribute)}):
        for other, value in values.attributes.get(name, ()):
            if isinstance(value, (ast.Tuple, ast.List, ast.Dict)) and other is not function:
                yield other.file, value


def _alternatives(node: ast.expr) -> Iterator[list[str]]:
    """Yield the innermost lists of texts: each is a set of names for one thing, or of things."""
    parts = node.values if isinstance(node, ast.Dict) else getattr(node, "elts", [])
    texts = [value for part in parts if part is not None and isinstance(value := constant(part), str)]
    if texts and not isinstance(node, ast.Dict):
        yield texts
    for part in parts:
        if isinstance(part, (ast.Tuple, ast.List, ast.Dict)):
            yield from _alternatives(part)


def _listed(texts: list[str], known: tuple[str, ...], evidence: Evidence, *, required: bool) -> Iterator[Read]:
    """Yield the cameras that a list names: one where the others are other names for it, else all."""
    meant = [name for name in texts if name in known]
    # A list of what one camera may be called holds strangers' names; a list of cameras holds ours.
    chosen = meant if 2 * len(meant) > len(texts) else meant[:1]
    for name in chosen:
        yield Read(f"{sdk.Obs.VISION}.{name}", required, Confidence.LIKELY, evidence)


def _fails(function: Function) -> bool:
    """Tell whether a function that looks for something raises where it finds nothing."""
    gives_up = any(node.value is None or constant(node.value) is None for node in function.of(ast.Return))
    return bool(function.of(ast.Raise)) and not gives_up
