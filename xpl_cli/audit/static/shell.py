"""Shell scripts as commands and words, from tree-sitter's grammar of bash; nothing is executed."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

from xpl_cli.audit.static.limits import TooMuchError

if TYPE_CHECKING:
    from tree_sitter import Node, Tree

_MOST_CHARACTERS: Final = 60_000
_MOST_LEVELS: Final = 100
_LONGEST_S: Final = 5.0
"""Seconds that the grammar, or bash, may take for one script: a thousand times what they do take."""
_PIECE: Final = 32_768
_SAID: Final = re.compile(r"line (\d+): (.+)")
_SETTERS: Final = frozenset(
    ("export", "local", "readonly", "declare", "typeset", "read", "mapfile", "readarray", "getopts")
)
TESTS: Final = frozenset(("[", "[[", "((", "test"))
"""What only asks."""
_GUARDED: Final = re.compile(r"\$\{(\w+):?[-=?+]")
_NAME: Final = re.compile(r"\$(?:\{[#!]?(\w+|[@*#?$!-])(:?[-=?+])?|(\d|[A-Za-z_]\w*|[@*#?$!-]))")
_POSITION: Final = re.compile(r"""["']?\$(?:(\d)|\{(\d+)(?:[:#%/^,?+-][^}]*(?:\}[^}]*)*)?\})["']?""")
_EXPANDS: Final = frozenset(("simple_expansion", "expansion"))
_SUBSTITUTES: Final = frozenset(("command_substitution", "process_substitution"))
_OPERATORS: Final = {"&&": "&&", "||": "||", "|": "|", "|&": "|", "&": "&"}
_REDIRECTS: Final = frozenset(("file_redirect", "heredoc_redirect", "herestring_redirect", "file_descriptor"))
_SIMPLE: Final = frozenset(("command", "declaration_command", "unset_command"))
_CONDITIONS: Final = {"if_statement": "if", "elif_clause": "elif", "while_statement": "while"}
_BLOCKS: Final = {"do_group": "do", "else_clause": "else", "compound_statement": "{"}


class Expansion(NamedTuple):
    """One `$name`, `${name}` or `${name:-default}` in a word; inside of substitutions too.

    Attributes:
        name: of the variable, or `1` for a positional argument.
        guard: `:-` and its like where the script says what happens if the variable is not set.
    """

    name: str
    guard: str


@dataclass(frozen=True)
class Word:
    """One word as it is written, with its 1-based place and what the shell replaces in it by values of variables."""

    raw: str
    line: int
    column: int
    expansions: tuple[Expansion, ...] = ()

    @property
    def text(self) -> str:
        """The word without its quotes; expansions stay as they are written."""
        return re.sub(r"""(?<!\\)["']""", "", self.raw)

    @property
    def position(self) -> int | None:
        """N for `$N`, `${N}` and `${N:-default}`: the positional argument that the word takes."""
        found = _POSITION.fullmatch(self.raw)
        return int(found.group(1) or found.group(2)) if found else None

    @property
    def variable(self) -> str | None:
        """`name` for `$name`, `${name}` and `${name:-default}`."""
        found = re.fullmatch(r"\$\{?([A-Za-z_]\w*)(?::?[-=?+].*)?\}?", self.text, re.DOTALL)
        return found.group(1) if found else None


@dataclass(frozen=True)
class Command:
    """One simple command: its words, its assignments, and how deep in loops and functions it stands.

    Attributes:
        words: all of it, assignments before it too; of a test its operands and operators.
        assignments: names and values that it assigns, of `export` and its like too.
        arguments: the words after leading assignments: the program and what it gets.
        keywords: words of the grammar that lead to it, such as `if`, `then`, `!`.
        end: the operator behind it, or behind a group whose last one it is: `&`, `&&`, `||` or `|`; "" for none.
    """

    words: tuple[Word, ...]
    assignments: tuple[tuple[str, Word], ...] = ()
    arguments: tuple[Word, ...] = ()
    loops: int = 0
    functions: int = 0
    keywords: tuple[str, ...] = ()
    end: str = ""

    @cached_property
    def name(self) -> str:
        """The program, without its folder; "" for a plain assignment."""
        return self.arguments[0].text.rpartition("/")[2] if self.arguments else ""


class Script(list[Command]):
    """The simple commands of a script, those of functions included and those of substitutions left out."""

    @cached_property
    def options(self) -> frozenset[str]:
        """What `set` turns on anywhere: `errexit`, `nounset`, `pipefail`."""
        letters = {"e": "errexit", "u": "nounset"}
        found: set[str] = set()
        for command in self:
            words = [word.text for word in command.words[1:]] if command.name == "set" else []
            for place, text in enumerate(words):
                if text.startswith("-"):
                    found |= {letters[letter] for letter in text[1:] if letter in letters}
                    found |= {*words[place + 1 : place + 2]} if text.endswith("o") else set()
        return frozenset(found)

    @cached_property
    def variables(self) -> frozenset[str]:
        """Every name that the script gives a value anywhere: by assignment, `for`, `read` and their like."""
        found: set[str] = set()
        for command in self:
            found.update(name for name, _ in command.assignments)
            if command.name in _SETTERS:
                found.update(re.split(r"[=\[]", word.text, maxsplit=1)[0] for word in command.arguments[1:])
            elif command.name == "printf" and len(command.arguments) > 2 and command.arguments[1].raw == "-v":
                found.add(command.arguments[2].text)
            for word in command.words:
                found.update(item.name for item in word.expansions if item.guard == ":=")
        return frozenset(found)

    @cached_property
    def checked(self) -> frozenset[str]:
        """Every name for which the script says somewhere what happens if it is not set, or empty."""
        found: set[str] = set()
        for command in self:
            for word in command.words:
                if command.name in TESTS:
                    found.update(item.name for item in word.expansions)
                found.update(_GUARDED.findall(word.raw))
        return frozenset(found)


def parse(script: str) -> Script:
    """Return the simple commands of a script. What is no shell is passed over.

    Raises:
        TooMuchError: if it is longer, has more words or levels, or takes longer than any that a person wrote.
    """
    if len(script) > _MOST_CHARACTERS:
        raise TooMuchError(f"more than {_MOST_CHARACTERS} characters")
    source = script.encode(errors="surrogatepass")
    reader = _Reader(source)
    reader.read(_tree(source).root_node, _Place())
    return Script(reader.found)


def refused(script: str) -> tuple[int, str] | None:
    """Return the line at which bash refuses a script, and what it says; None if it takes it.

    bash reads it and runs nothing of it. Patterns that a script turns on by `shopt -s extglob` are taken too.

    Raises:
        FileNotFoundError: if bash is not installed.
        TooMuchError: if bash is not done with it in time.
    """
    bash = shutil.which("bash")
    if bash is None:
        raise FileNotFoundError("bash is not installed")
    said = ""
    for options in ((), ("-O", "extglob")):
        try:
            done = subprocess.run(
                [bash, "--norc", *options, "-n"],
                input=script.encode(errors="replace"),
                capture_output=True,
                check=False,
                timeout=_LONGEST_S,
                env={"LC_ALL": "C"},  # its words, and no BASH_ENV
            )
        except subprocess.TimeoutExpired:
            raise TooMuchError(f"bash is not done with it in {_LONGEST_S:.0f} s") from None
        if done.returncode == 0:
            return None
        said = said or done.stderr.decode(errors="replace")
    found = _SAID.search(said)
    return (int(found.group(1)), found.group(2)) if found else (1, said.strip() or "bash ends with an error")


def _tree(source: bytes) -> Tree:
    """Return the syntax tree of a script, in UTF-8; what takes longer than a script of a person is given up."""
    import tree_sitter_bash
    from tree_sitter import Language, Parser

    end = time.process_time() + _LONGEST_S
    try:
        return Parser(Language(tree_sitter_bash.language())).parse(
            lambda offset, _: source[offset : offset + _PIECE],
            progress_callback=lambda _, __: time.process_time() > end,  # true ends it
        )
    except ValueError:
        raise TooMuchError(f"it takes longer than {_LONGEST_S:.0f} s to parse") from None


@dataclass(frozen=True)
class _Place:
    """Where a command stands."""

    loops: int = 0
    functions: int = 0
    levels: int = 0
    keywords: tuple[str, ...] = ()

    def below(self, *keywords: str, loops: int = 0, functions: int = 0) -> _Place:
        return _Place(self.loops + loops, self.functions + functions, self.levels + 1, keywords)


class _Reader:
    """Goes through the syntax tree of a script, and collects its simple commands.

    Args:
        source: the script, in UTF-8.
    """

    def __init__(self, source: bytes) -> None:
        self.source = source
        self.found: list[Command] = []
        self._lines = source.split(b"\n")

    def read(self, node: Node, place: _Place) -> None:
        """Collect the commands of a node, and note what ends each."""
        if place.levels > _MOST_LEVELS:
            raise TooMuchError(f"nested more than {_MOST_LEVELS} levels deep")
        kind = node.type
        if kind in _SIMPLE:
            self._add([child for child in node.children if child.type not in _REDIRECTS], place)
        elif kind in {"variable_assignment", "variable_assignments"}:
            self._add([node] if kind == "variable_assignment" else node.named_children, place)
        elif kind == "test_command":
            self._add([node.children[0], *_operands(node)], place)
        elif kind == "compound_statement" and node.children[0].type == "((":
            self._arithmetic(node, place)
        elif kind == "function_definition":
            self._all(node.children, place.below(functions=1))
        elif kind in {"for_statement", "c_style_for_statement", "select_statement"}:
            self._for(node, place)
        elif kind in _CONDITIONS:
            self._condition(node, place)
        elif kind not in _SUBSTITUTES and kind not in _REDIRECTS - {"heredoc_redirect"}:
            more = place.keywords if kind in {"list", "pipeline", "redirected_statement"} else ()
            more += (_BLOCKS[kind],) if kind in _BLOCKS else ("!",) if kind == "negated_command" else ()
            before = place.keywords if kind == "negated_command" else ()
            self._all(node.children, place.below(*before, *more))

    def _all(self, nodes: list[Node], place: _Place) -> None:
        """Collect what these nodes hold; keywords count for the first of them alone."""
        for child in nodes:
            if child.type in _OPERATORS:
                self._end(_OPERATORS[child.type])
            elif child.is_named and child.type != "comment":
                before = len(self.found)
                self.read(child, place)
                if len(self.found) > before:
                    place = replace(place, keywords=())

    def _end(self, operator: str) -> None:
        if self.found:
            self.found[-1] = replace(self.found[-1], end=operator)

    def _condition(self, node: Node, place: _Place) -> None:
        """Collect an `if` or a `while`: all of its condition is asked, what follows is done."""
        keyword = node.children[0].type
        loops = int(node.type == "while_statement")
        asked = next((at for at, child in enumerate(node.children) if child.type in {"then", "do_group"}), 0)
        for child in node.children[1:asked]:
            self._all([child], place.below(keyword, loops=loops))
        self._all(node.children[asked:], place.below(*(() if loops else ("then",)), loops=loops))

    def _arithmetic(self, node: Node, place: _Place) -> None:
        """Collect `((...))`: a test that may give each of its names a value."""
        words = (self._word(node.children[0]), *map(self._word, node.named_children))
        given = tuple((self._text(name), self._word(name)) for name in _below(node, "variable_name"))
        self._append(Command(words, given, words, place.loops, place.functions, place.keywords))

    def _for(self, node: Node, place: _Place) -> None:
        body = next((child for child in node.children if child.type in {"do_group", "compound_statement"}), None)
        head = [child for child in node.named_children if child != body]
        if node.type == "c_style_for_statement":
            names = [one for child in head for one in _below(child, "variable_name")]
        else:
            names = head[:1]
        given = tuple((self._text(name), self._word(name)) for name in names)
        self._append(Command(tuple(map(self._word, head)), given, (), place.loops, place.functions, ("for",)))
        if body is not None:
            self._all(body.children, place.below("do", loops=1))

    def _add(self, parts: list[Node], place: _Place) -> None:
        """Collect a simple command that consists of these nodes."""
        words = tuple(map(self._word, parts))
        assigned: list[tuple[str, Word]] = []
        leading = 0
        for at, part in enumerate(parts):
            if part.type != "variable_assignment":
                break
            leading = at + 1
        for part in parts:
            name, value = part.child_by_field_name("name"), part.child_by_field_name("value")
            if part.type == "variable_assignment" and name is not None:
                assigned.append((self._text(name), self._empty(part) if value is None else self._word(value)))
        self._append(Command(words, tuple(assigned), words[leading:], place.loops, place.functions, place.keywords))

    def _append(self, command: Command) -> None:
        if command.words:
            self.found.append(command)

    def _word(self, node: Node) -> Word:
        line, column = node.start_point
        return Word(self._text(node), line + 1, self._column(line, column), tuple(_expansions(node)))

    def _empty(self, assignment: Node) -> Word:
        line, column = assignment.end_point
        return Word("", line + 1, self._column(line, column))

    def _column(self, line: int, offset: int) -> int:
        """Turn an offset in bytes into a column."""
        return len(self._lines[line][:offset].decode(errors="replace")) + 1

    def _text(self, node: Node) -> str:
        return self.source[node.start_byte : node.end_byte].decode(errors="replace")


def _operands(node: Node) -> Iterator[Node]:
    """Yield what stands between the brackets of a test: operands and operators."""
    for child in node.children if node.type == "test_command" else [node]:
        if child.type in {"binary_expression", "unary_expression", "parenthesized_expression", "negated_command"}:
            for part in child.children:
                yield from _operands(part)
        elif child.is_named or child.type not in {"[", "[[", "((", "]", "]]", "))"}:
            yield child


def _below(node: Node, *kinds: str) -> Iterator[Node]:
    """Yield the nodes of some kinds in a node."""
    waiting = [node]
    while waiting:
        entry = waiting.pop()
        if entry.type in kinds:
            yield entry
        waiting += reversed(entry.children)


def _expansions(node: Node) -> Iterator[Expansion]:
    """Yield the expansions of a word, those inside of substitutions too."""
    for entry in _below(node, *_EXPANDS):
        found = _NAME.match((entry.text or b"").decode(errors="replace"))
        if found is not None:
            yield Expansion(found.group(1) or found.group(3), found.group(2) or "")
