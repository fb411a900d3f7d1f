"""Parse untrusted YAML; errors have a line and a column.

PyYAML's safe loader runs no code, but a document can still crash its process: deep nesting overflows libyaml's stack,
aliases of aliases expand beyond memory, and a number of a million digits takes hours. Where a scalar does not fit its
tag, the loader raises arbitrary exceptions. So limits are checked before anything is built, and only `yaml.YAMLError`
is raised.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Final

import yaml

MOST_BYTES: Final = 2 * 1024 * 1024
"""Larger files are data, not manifests."""
_MOST_LEVELS: Final = 100
_MOST_VALUES: Final = 100_000
_MOST_DIGITS: Final = 400

_LONG_NUMBER: Final = re.compile(rf"[\da-fA-FxX_:.,]{{{_MOST_DIGITS}}}")
"""What may be one, hexadecimal ones included: Python reads those of any length, and writes none of them out."""

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# What YAML allows as a character (YAML 1.1, 5.1), without the byte-order mark's meaning.
_FORBIDDEN: Final = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_OTHER_ENCODINGS: Final = {b"\xff\xfe\x00\x00": "UTF-32", b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}
_BREAK: Final = re.compile(r"\r\n|\r|\n|\x85|\u2028|\u2029")
# PyYAML says what its scanner met; this is what the person who wrote it has to know.
_PLAINER: Final = {
    "found character '\\t' that cannot start any token": "a tab stands where YAML takes only spaces",
    "mapping values are not allowed in this context": "a second colon, or a line that is indented too far",
    "found character that cannot start any token": "a character that no value may start with, unless it is quoted",
    "could not find expected ':'": "a key without a colon after it",
    "did not find expected key": "a line that is indented otherwise than the keys around it",
    "did not find expected ',' or ']'": "a list that is opened by [ is not closed by ]",
    "did not find expected ',' or '}'": "a map that is opened by { is not closed by }",
    "found undefined alias": "an alias (*name) without its anchor (&name) before it",
    "found unexpected end of stream": "a quotation that is not closed",
    "found unhashable key": "a list or a map as the key of a map",
    "but found another document": "a second document (---), where one is expected",
}


@dataclass(frozen=True)
class YamlDocument:
    """What a YAML document holds, and its nodes, which know their places; None for an empty one."""

    data: Any
    root: yaml.Node | None


def parse(content: bytes | str) -> Any:
    """Return the content of a YAML document (see `read`)."""
    return read(content).data


def read(content: bytes | str) -> YamlDocument:
    """Parse one YAML document with the safe loader (libyaml's where it is built in).

    Raises:
        yaml.MarkedYAMLError: if it is not YAML in UTF-8, or larger, deeper or more tangled than any honest document;
            `problem` says it in plain words.
    """
    text = _decoded(content)
    if (found := _FORBIDDEN.search(text)) is not None:
        raise _refused(f"the character {found.group()!r} is not allowed in YAML", text, found.start())
    try:
        tangled = _survey(text)
        root = _composed(text)
    except yaml.MarkedYAMLError as error:
        problem = _plain(error, text)
        # An unclosed bracket has to be fixed where it was opened.
        opened = error.context_mark if "is not closed" in problem else None
        raise _marked(problem, opened or error.problem_mark) from None
    if root is None:
        return YamlDocument(None, None)
    if tangled:
        _measure(root)
    return YamlDocument(_constructed(root), root)


def _decoded(content: bytes | str) -> str:
    if len(content) > MOST_BYTES:
        raise _refused(f"the file has {len(content)} bytes: expected at most {MOST_BYTES}", "", 0)
    if isinstance(content, str):
        return content.removeprefix("\ufeff")
    for mark, name in _OTHER_ENCODINGS.items():
        if content.startswith(mark):
            raise _refused(f"the file is {name}: expected UTF-8", "", 0)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode(errors="replace")
        raise _refused(f"the byte {error.object[error.start]:#04x} is not UTF-8", before, len(before)) from None


def _refused(problem: str, text: str, place: int) -> yaml.MarkedYAMLError:
    """Return the error for a position of a text."""
    breaks = list(_BREAK.finditer(text, 0, place))
    start = breaks[-1].end() if breaks else 0
    mark = yaml.Mark("", place, len(breaks), place - start, None, 0)
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def _at(problem: str, node: yaml.Node | yaml.Event) -> yaml.MarkedYAMLError:
    return _marked(problem, node.start_mark)


def _marked(problem: str, mark: Any) -> yaml.MarkedYAMLError:
    """Return an error at a mark of libyaml or PyYAML."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def _survey(text: str) -> bool:
    """Check limits that would crash libyaml's composer; tell whether the document's size has to be measured.

    That is aliases, and numbers of many digits.
    """
    depth, aliases, values = 0, False, 0
    for event in yaml.parse(text, Loader=_Loader):
        values += isinstance(event, yaml.NodeEvent)
        if values > _MOST_VALUES:
            raise _at(f"more than {_MOST_VALUES} values", event)
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MOST_LEVELS:
            raise _at(f"nested more than {_MOST_LEVELS} levels deep", event)
        aliases = aliases or isinstance(event, yaml.AliasEvent)
    return aliases or _LONG_NUMBER.search(text) is not None


def _composed(text: str) -> yaml.Node | None:
    loader = _Loader(text)
    try:
        root: yaml.Node | None = loader.get_single_node()
    finally:
        loader.dispose()
    return root


def _plain(error: yaml.MarkedYAMLError, text: str) -> str:
    """Return a parser's problem in plain words."""
    problem = " ".join(str(error.problem or error).split())
    mark = error.problem_mark
    lines = _BREAK.split(text)
    line = lines[mark.line] if mark is not None and mark.line < len(lines) else ""
    if "\t" in line[: len(line) - len(line.lstrip())]:
        return "a tab indents this line: YAML is indented by spaces"
    plain = next((words for known, words in _PLAINER.items() if problem.startswith(known)), None)
    return f"{plain} ({problem})" if plain else problem


def _measure(root: yaml.Node) -> None:
    """Check the size of a document with all aliases expanded."""
    sizes: dict[int, tuple[int, int]] = {}
    open_: set[int] = set()
    waiting: list[tuple[yaml.Node, bool]] = [(root, False)]
    while waiting:
        node, entered = waiting.pop()
        if id(node) in sizes:
            continue
        if isinstance(node, yaml.ScalarNode):
            _check_number(node)
            sizes[id(node)] = (1, 1)
            continue
        inner = [part for entry in node.value for part in (entry if isinstance(entry, tuple) else (entry,))]
        if not entered:
            open_.add(id(node))
            waiting.append((node, True))
            for part in inner:
                if id(part) in open_:
                    raise _at("an alias makes this contain itself", part)
                waiting.append((part, False))
            continue
        open_.discard(id(node))
        size = 1 + sum(sizes[id(part)][0] for part in inner)
        depth = 1 + max((sizes[id(part)][1] for part in inner), default=0)
        if size > _MOST_VALUES:
            raise _at(f"aliases unfold into more than {_MOST_VALUES} values", node)
        if depth > _MOST_LEVELS:
            raise _at(f"nested more than {_MOST_LEVELS} levels deep", node)
        sizes[id(node)] = (size, depth)


def _check_number(node: yaml.ScalarNode) -> None:
    if node.tag.endswith((":int", ":float")) and len(node.value) > _MOST_DIGITS:
        raise _at(f"a number of {len(node.value)} characters: expected at most {_MOST_DIGITS}", node)


def _constructed(root: yaml.Node) -> Any:
    loader = _Loader("")
    try:
        return loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        raise _marked(_plain(error, ""), error.problem_mark) from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise _misfit(root, error) from None
    finally:
        loader.dispose()


def _misfit(root: yaml.Node, error: Exception) -> yaml.MarkedYAMLError:
    """Return the error for a scalar that does not fit its tag, such as the date 2024-99-99."""
    waiting, seen = [root], set()
    while waiting:
        node = waiting.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if not isinstance(node, yaml.ScalarNode):
            waiting += [part for entry in node.value for part in (entry if isinstance(entry, tuple) else (entry,))]
            continue
        loader = _Loader("")
        try:
            loader.construct_document(node)
        except Exception:  # noqa: BLE001 - any exception identifies the scalar
            return _at(f"{_short(node.value)} is no {node.tag.rpartition(':')[2]} (quote it if it is text)", node)
        finally:
            loader.dispose()
    return _at(f"this is not a document that can be read: {error}", root)


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
