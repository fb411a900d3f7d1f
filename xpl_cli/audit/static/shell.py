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
"""Timeout of the grammar, and of bash, for one script, s: a thousand times the usual time."""
_PIECE: Final = 32_768
_ERROR_LINE: Final = re.compile(r"line (\d+): (.+)")
_SETTERS: Final = frozenset(
    ("export", "local", "readonly", "declare", "typeset", "read", "mapfile", "readarray", "getopts")
)
TESTS: Final = frozenset(("[", "[[", "((", "test"))
"""Commands that only test."""
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
        guard: `:-` and its like, if the expansion handles an unset variable.
    """

    name: str
    guard: str


@dataclass(frozen=True)
class ShellWord:
    """One word as it is written, with its 1-based position and its expansions."""

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
        """N for `$N`, `${N}` and `${N:-default}`: the positional argument that the word expands."""
        match = _POSITION.fullmatch(self.raw)
        return int(match.group(1) or match.group(2)) if match else None

    @property
    def variable(self) -> str | None:
        """`name` for `$name`, `${name}` and `${name:-default}`."""
        match = re.fullmatch(r"\$\{?([A-Za-z_]\w*)(?::?[-=?+].*)?\}?", self.text, re.DOTALL)
        return match.group(1) if match else None


@dataclass(frozen=True)
class ShellCommand:
    """One simple command: its words, its assignments, and its nesting in loops and functions.

    Attributes:
        words: all of it, assignments before it too; of a test its operands and operators.
        assignments: names and values that it assigns, of `export` and its like too.
        arguments: the words after leading assignments: the program and its arguments.
        keywords: keywords before it, such as `if`, `then`, `!`.
        end: the operator after it, or after a group whose last command it is: `&`, `&&`, `||` or `|`; "" for none.
    """

    words: tuple[ShellWord, ...]
    assignments: tuple[tuple[str, ShellWord], ...] = ()
    arguments: tuple[ShellWord, ...] = ()
    loops: int = 0
    functions: int = 0
    keywords: tuple[str, ...] = ()
    end: str = ""

    @cached_property
    def name(self) -> str:
        """The program, without its folder; "" for a plain assignment."""
        return self.arguments[0].text.rpartition("/")[2] if self.arguments else ""


class ShellScript(list[ShellCommand]):
    """The simple commands of a script, including those of functions and without those of substitutions."""

    @cached_property
    def options(self) -> frozenset[str]:
        """Options that `set` enables anywhere: `errexit`, `nounset`, `pipefail`."""
        letters = {"e": "errexit", "u": "nounset"}
        options: set[str] = set()
        for command in self:
            words = [word.text for word in command.words[1:]] if command.name == "set" else []
            for index, text in enumerate(words):
                if text.startswith("-"):
                    options |= {letters[letter] for letter in text[1:] if letter in letters}
                    options |= {*words[index + 1 : index + 2]} if text.endswith("o") else set()
        return frozenset(options)

    @cached_property
    def variables(self) -> frozenset[str]:
        """Every variable that the script sets anywhere: by assignment, `for`, `read` and their like."""
        names: set[str] = set()
        for command in self:
            names.update(name for name, _ in command.assignments)
            if command.name in _SETTERS:
                names.update(re.split(r"[=\[]", word.text, maxsplit=1)[0] for word in command.arguments[1:])
            elif command.name == "printf" and len(command.arguments) > 2 and command.arguments[1].raw == "-v":
                names.add(command.arguments[2].text)
            for word in command.words:
                names.update(item.name for item in word.expansions if item.guard == ":=")
        return frozenset(names)

    @cached_property
    def checked(self) -> frozenset[str]:
        """Every variable for which the script handles an unset or empty value somewhere."""
        names: set[str] = set()
        for command in self:
            for word in command.words:
                if command.name in TESTS:
                    names.update(item.name for item in word.expansions)
                names.update(_GUARDED.findall(word.raw))
        return frozenset(names)


def parse(script: str) -> ShellScript:
    """Return the simple commands of a script. What is no shell is passed over.

    Raises:
        TooMuchError: if it is longer, has more words or levels, or takes longer than any that a person wrote.
    """
    if len(script) > _MOST_CHARACTERS:
        raise TooMuchError(f"more than {_MOST_CHARACTERS} characters")
    source = script.encode(errors="surrogatepass")
    reader = _CommandCollector(source)
    reader.collect(_parse_tree(source).root_node, _Context())
    return ShellScript(reader.commands)


def bash_error(script: str) -> tuple[int, str] | None:
    """Return the line at which bash refuses a script, and what it says; None if it takes it.

    bash reads it and runs nothing of it. Patterns that a script turns on by `shopt -s extglob` are taken too.

    Raises:
        FileNotFoundError: if bash is not installed.
        TooMuchError: if bash is not done with it in time.
    """
    bash = shutil.which("bash")
    if bash is None:
        raise FileNotFoundError("bash is not installed")
    output = ""
    for options in ((), ("-O", "extglob")):
        try:
            process = subprocess.run(
                [bash, "--norc", *options, "-n"],
                input=script.encode(errors="replace"),
                capture_output=True,
                check=False,
                timeout=_LONGEST_S,
                env={"LC_ALL": "C"},  # its words, and no BASH_ENV
            )
        except subprocess.TimeoutExpired:
            raise TooMuchError(f"bash is not done with it in {_LONGEST_S:.0f} s") from None
        if process.returncode == 0:
            return None
        output = output or process.stderr.decode(errors="replace")
    match = _ERROR_LINE.search(output)
    return (int(match.group(1)), match.group(2)) if match else (1, output.strip() or "bash ends with an error")


def _parse_tree(source: bytes) -> Tree:
    """Return the syntax tree of a script, in UTF-8.

    Raises:
        TooMuchError: if parsing exceeds the time limit.
    """
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
class _Context:
    """The nesting of a command."""

    loops: int = 0
    functions: int = 0
    levels: int = 0
    keywords: tuple[str, ...] = ()

    def nested(self, *keywords: str, loops: int = 0, functions: int = 0) -> _Context:
        return _Context(self.loops + loops, self.functions + functions, self.levels + 1, keywords)


class _CommandCollector:
    """Collects the simple commands of a script from its syntax tree.

    Args:
        source: the script, in UTF-8.
    """

    def __init__(self, source: bytes) -> None:
        self.source = source
        self.commands: list[ShellCommand] = []
        self._lines = source.split(b"\n")

    def collect(self, node: Node, context: _Context) -> None:
        """Collect the commands of a node, with the operator after each."""
        if context.levels > _MOST_LEVELS:
            raise TooMuchError(f"nested more than {_MOST_LEVELS} levels deep")
        kind = node.type
        if kind in _SIMPLE:
            self._collect_command([child for child in node.children if child.type not in _REDIRECTS], context)
        elif kind in {"variable_assignment", "variable_assignments"}:
            self._collect_command([node] if kind == "variable_assignment" else node.named_children, context)
        elif kind == "test_command":
            self._collect_command([node.children[0], *_operands(node)], context)
        elif kind == "compound_statement" and node.children[0].type == "((":
            self._collect_arithmetic(node, context)
        elif kind == "function_definition":
            self._collect_all(node.children, context.nested(functions=1))
        elif kind in {"for_statement", "c_style_for_statement", "select_statement"}:
            self._collect_for(node, context)
        elif kind in _CONDITIONS:
            self._collect_condition(node, context)
        elif kind not in _SUBSTITUTES and kind not in _REDIRECTS - {"heredoc_redirect"}:
            more = context.keywords if kind in {"list", "pipeline", "redirected_statement"} else ()
            more += (_BLOCKS[kind],) if kind in _BLOCKS else ("!",) if kind == "negated_command" else ()
            before = context.keywords if kind == "negated_command" else ()
            self._collect_all(node.children, context.nested(*before, *more))

    def _collect_all(self, nodes: list[Node], context: _Context) -> None:
        """Collect the commands of these nodes; keywords apply only to the first one."""
        for child in nodes:
            if child.type in _OPERATORS:
                self._set_end(_OPERATORS[child.type])
            elif child.is_named and child.type != "comment":
                before = len(self.commands)
                self.collect(child, context)
                if len(self.commands) > before:
                    context = replace(context, keywords=())

    def _set_end(self, operator: str) -> None:
        if self.commands:
            self.commands[-1] = replace(self.commands[-1], end=operator)

    def _collect_condition(self, node: Node, context: _Context) -> None:
        """Collect an `if` or a `while`: the commands of its condition, then those of its body."""
        keyword = node.children[0].type
        loops = int(node.type == "while_statement")
        body_start = next((at for at, child in enumerate(node.children) if child.type in {"then", "do_group"}), 0)
        for child in node.children[1:body_start]:
            self._collect_all([child], context.nested(keyword, loops=loops))
        self._collect_all(node.children[body_start:], context.nested(*(() if loops else ("then",)), loops=loops))

    def _collect_arithmetic(self, node: Node, context: _Context) -> None:
        """Collect `((...))`: a test that may set each of its variables."""
        words = (self._word(node.children[0]), *map(self._word, node.named_children))
        assignments = tuple(
            (self._text(name), self._word(name)) for name in _descendants_of_type(node, "variable_name")
        )
        self._append(ShellCommand(words, assignments, words, context.loops, context.functions, context.keywords))

    def _collect_for(self, node: Node, context: _Context) -> None:
        body = next((child for child in node.children if child.type in {"do_group", "compound_statement"}), None)
        head = [child for child in node.named_children if child != body]
        if node.type == "c_style_for_statement":
            names = [one for child in head for one in _descendants_of_type(child, "variable_name")]
        else:
            names = head[:1]
        assignments = tuple((self._text(name), self._word(name)) for name in names)
        self._append(
            ShellCommand(tuple(map(self._word, head)), assignments, (), context.loops, context.functions, ("for",))
        )
        if body is not None:
            self._collect_all(body.children, context.nested("do", loops=1))

    def _collect_command(self, parts: list[Node], context: _Context) -> None:
        """Collect a simple command that consists of these nodes."""
        words = tuple(map(self._word, parts))
        assigned: list[tuple[str, ShellWord]] = []
        leading = 0
        for at, part in enumerate(parts):
            if part.type != "variable_assignment":
                break
            leading = at + 1
        for part in parts:
            name, value = part.child_by_field_name("name"), part.child_by_field_name("value")
            if part.type == "variable_assignment" and name is not None:
                assigned.append((self._text(name), self._empty(part) if value is None else self._word(value)))
        self._append(
            ShellCommand(words, tuple(assigned), words[leading:], context.loops, context.functions, context.keywords)
        )

    def _append(self, command: ShellCommand) -> None:
        if command.words:
            self.commands.append(command)

    def _word(self, node: Node) -> ShellWord:
        line, column = node.start_point
        return ShellWord(self._text(node), line + 1, self._column(line, column), tuple(_expansions(node)))

    def _empty(self, assignment: Node) -> ShellWord:
        line, column = assignment.end_point
        return ShellWord("", line + 1, self._column(line, column))

    def _column(self, line: int, offset: int) -> int:
        """Convert an offset in bytes to a column."""
        return len(self._lines[line][:offset].decode(errors="replace")) + 1

    def _text(self, node: Node) -> str:
        return self.source[node.start_byte : node.end_byte].decode(errors="replace")


def _operands(node: Node) -> Iterator[Node]:
    """Yield the operands and operators between the brackets of a test."""
    for child in node.children if node.type == "test_command" else [node]:
        if child.type in {"binary_expression", "unary_expression", "parenthesized_expression", "negated_command"}:
            for part in child.children:
                yield from _operands(part)
        elif child.is_named or child.type not in {"[", "[[", "((", "]", "]]", "))"}:
            yield child


def _descendants_of_type(node: Node, *kinds: str) -> Iterator[Node]:
    """Yield the descendants of a node with these types."""
    waiting = [node]
    while waiting:
        entry = waiting.pop()
        if entry.type in kinds:
            yield entry
        waiting += reversed(entry.children)


def _expansions(node: Node) -> Iterator[Expansion]:
    """Yield the expansions of a word, including those inside of substitutions."""
    for entry in _descendants_of_type(node, *_EXPANDS):
        match = _NAME.match((entry.text or b"").decode(errors="replace"))
        if match is not None:
            yield Expansion(match.group(1) or match.group(3), match.group(2) or "")
