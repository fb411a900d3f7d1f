"""Shell scripts as commands and words. Enough of the grammar to know who is called with what; nothing is executed."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

from xpl_cli.audit.static.limits import TooMuchError

_OPENERS: Final = frozenset(("while", "until", "for"))
_KEYWORDS: Final = frozenset(
    ("if", "then", "elif", "else", "do", "while", "until", "!", "{", "}", "fi", "done", "time")
)
_GRAMMAR: Final = _KEYWORDS | _OPENERS
_MOST_WORDS: Final = 50_000
_MOST_LEVELS: Final = 100
_HEREDOC: Final = re.compile(r"<<-?\s*(['\"\\]?)([A-Za-z_]\w*)\1")
_REDIRECTION: Final = re.compile(r"<<<|&>>?|[<>]+[&|]?[\d-]*")
_ASSIGNMENT: Final = re.compile(r"([A-Za-z_]\w*)\+?=(.*)", re.DOTALL)
_DECLARES: Final = ("export", "local", "readonly", "declare", "typeset")
_SETTERS: Final = frozenset((*_DECLARES, "read", "mapfile", "readarray", "getopts"))
_GUARDED: Final = re.compile(r"\$\{(\w+):?[-=?+]")
_PLAIN: Final = re.compile(r"[^\s;&|<>()\\'\"$`]+")
_QUOTED: Final = re.compile(r"[^\"$\\]+")
_INTRICATE: Final = re.compile(r"[\\'(`]|.\"(?!$)|^[^\"].*\"", re.DOTALL)
_SPECIAL: Final = re.compile(r"[\\'\"()`$]")
_NAME: Final = re.compile(r"\$(?:\{[#!]?(\w+|[@*#?$!-])(:?[-=?+])?|(\d|[A-Za-z_]\w*|[@*#?$!-]))")
_POSITION: Final = re.compile(r"""["']?\$(?:(\d)|\{(\d+)(?:[:#%/^,?+-][^}]*(?:\}[^}]*)*)?\})["']?""")


class Expansion(NamedTuple):
    """One `$name`, `${name}` or `${name:-default}` in a word; inside of substitutions too.

    Attributes:
        name: of the variable, or `1` for a positional argument.
        guard: `:-` and its like where the script says what happens if the variable is not set.
        quoted: whether the shell leaves its value in one piece.
    """

    name: str
    guard: str
    quoted: bool


@dataclass(frozen=True)
class Word:
    """One word as it is written, with its 1-based place."""

    raw: str
    line: int
    column: int

    @property
    def text(self) -> str:
        """The word without its quotes; expansions stay as they are written."""
        return re.sub(r"""(?<!\\)["']""", "", self.raw)

    @cached_property
    def expansions(self) -> tuple[Expansion, ...]:
        """What the shell replaces in it by values of variables."""
        return tuple(_expansions(self.raw)) if "$" in self.raw else ()

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
    """One simple command: its assignments, its words, and how deep in loops and functions it stands.

    Attributes:
        keywords: words of the grammar before it, such as `if`, `then`, `!`.
        end: what ends it: `&`, `&&`, `||`, `|`, `;`, `)`, a line's end, or "" at the end of the script.
    """

    words: tuple[Word, ...]
    loops: int
    functions: int = 0
    keywords: tuple[str, ...] = ()
    end: str = ""

    @cached_property
    def assignments(self) -> list[tuple[str, Word]]:
        """Names and values that the command assigns, of `export` and its like too."""
        words = self.words
        if words and words[0].raw in _DECLARES:
            words = words[1:]
        found: list[tuple[str, Word]] = []
        for word in words:
            matched = _ASSIGNMENT.fullmatch(word.raw)
            if matched is None:
                break
            value = Word(matched.group(2), word.line, word.column + matched.start(2))
            found.append((matched.group(1), value))
        return found

    @cached_property
    def arguments(self) -> tuple[Word, ...]:
        """The words after leading assignments: the program and what it gets."""
        for place, word in enumerate(self.words):
            if _ASSIGNMENT.fullmatch(word.raw) is None:
                return self.words[place:]
        return ()

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
            elif "for" in command.keywords or (len(command.words) > 1 and command.words[1].raw == "="):
                found.add(command.words[0].raw)  # `for name in`, and `name = 0` of arithmetic
            for word in command.words:
                if ":=" in word.raw:
                    found.update(item.name for item in word.expansions if item.guard == ":=")
        return frozenset(found)

    @cached_property
    def checked(self) -> frozenset[str]:
        """Every name for which the script says somewhere what happens if it is not set, or empty."""
        found: set[str] = set()
        for command in self:
            is_test = command.name in {"[", "[[", "test"} or command.words[0].raw[0] == "-"
            for word in command.words:
                if is_test:
                    found.update(item.name for item in word.expansions)
                elif "${" in word.raw:
                    found.update(_GUARDED.findall(word.raw))
        return frozenset(found)


def parse(script: str) -> Script:
    """Return the simple commands of a script.

    Raises:
        TooMuchError: if it has more words, or is nested more deeply, than any that a person wrote.
    """
    return Script(_Parser(script).commands())


def _expansions(raw: str) -> Iterator[Expansion]:
    """Yield the expansions of a word; single quotes hide them, except within double quotes."""
    if not _INTRICATE.search(raw):
        for braced, guard, bare in _NAME.findall(raw):
            yield Expansion(braced or bare, guard, raw[0] == '"')
        return
    quoted, outer, at = False, list[bool](), 0
    while (special := _SPECIAL.search(raw, at)) is not None:
        at, character = special.end(), special.group()
        if character == "\\":
            at += 1
        elif character == "'" and not quoted:
            at = (raw.find("'", at) + 1) or len(raw)
        elif character == '"':
            quoted = not quoted
        elif character == "(":
            outer.append(quoted)
            quoted = False
        elif character == ")" and outer:
            quoted = outer.pop()
        elif character == "$" and (name := _NAME.match(raw, at - 1)) is not None:
            yield Expansion(name.group(1) or name.group(3), name.group(2) or "", quoted)
            at = name.end()


class _Parser:
    def __init__(self, script: str) -> None:
        self._script = script
        self._at = 0
        self._line_starts = [0, *(found.end() for found in re.finditer("\n", script))]
        self._found: list[Command] = []
        self._words: list[Word] = []
        self._read = 0
        self._depth = 0
        self._loops = 0
        self._blocks: list[bool] = []  # for each open brace, whether it is a function's
        self._is_function = False
        self._heredocs: list[str] = []

    def commands(self) -> list[Command]:
        while self._at < len(self._script):
            if not self._skipped():
                self._next()
        self._end()
        return self._found

    def _skipped(self) -> bool:
        """Move past what separates words: blanks, continued lines, comments."""
        script, character = self._script, self._script[self._at]
        if character in " \t":
            self._at += 1
        elif script.startswith("\\\n", self._at):
            self._at += 2
        elif character == "#":
            end = script.find("\n", self._at)
            self._at = len(script) if end < 0 else end
        else:
            return False
        return True

    def _next(self) -> None:
        """Move past the end of a command, a redirection, or a word."""
        script, character = self._script, self._script[self._at]
        if character == "\n":
            self._end("\n")
            self._at += 1
            self._skip_heredocs()
        elif not script.startswith("<<<", self._at) and (found := _HEREDOC.match(script, self._at)):
            self._heredocs.append(found.group(2))
            self._at = found.end()
        elif found := _REDIRECTION.match(script, self._at):
            if self._words and self._words[-1].raw.isdigit() and script[self._at - 1].isdigit():
                self._words.pop()  # the `2` of `2>&1`
            self._at = found.end()
        elif script.startswith("()", self._at) and len(self._words) == 1:
            self._words = []
            self._is_function = True
            self._at += 2
        elif character in ";&|()":
            operator = character * 2 if character in "&|" and script.startswith(character * 2, self._at) else character
            self._end(operator)
            self._at += len(operator)
        else:
            self._word()

    def _end(self, operator: str = "") -> None:
        words, keywords = self._words, list[str]()
        for word in itertools.takewhile(lambda word: word.raw in _GRAMMAR, words):
            keyword = word.raw
            keywords.append(keyword)
            self._loops += (keyword in _OPENERS) - (keyword == "done")
            if keyword == "{":
                self._blocks.append(self._is_function)
                self._is_function = False
            elif keyword == "}" and self._blocks:
                self._blocks.pop()
        words = words[len(keywords) :]
        if len(self._blocks) > _MOST_LEVELS:
            raise TooMuchError(f"nested more than {_MOST_LEVELS} levels deep")
        if words and words[0].raw == "function":
            self._is_function = True
            self._blocks += [True] * (words[-1].raw == "{")
        elif words:
            nested = max(self._loops, 0), sum(self._blocks)
            self._found.append(Command(tuple(words), *nested, tuple(keywords), operator))
        elif self._found and operator in {"&", "|", "||"}:  # of a group: `( ... ) &`
            self._found[-1] = replace(self._found[-1], end=operator)
        self._words = []

    def _word(self) -> None:
        start = self._at
        while self._at < len(self._script) and self._script[self._at] not in " \t\n;&|<>()":
            self._piece()
        if self._at == start:
            self._at += 1
            return
        # `name=(a b)` is an array: its words stay together.
        if self._script.startswith("(", self._at) and self._script[self._at - 1] == "=":
            self._group("(", ")")
        line = self._line_of(start)
        self._read += 1
        if self._read > _MOST_WORDS:
            raise TooMuchError(f"more than {_MOST_WORDS} words")
        self._words.append(Word(self._script[start : self._at], line, start - self._line_starts[line - 1] + 1))

    def _piece(self) -> None:
        """Move past one character, quotation or expansion."""
        script = self._script
        character = script[self._at]
        if character == "\\":
            self._at += 2
        elif character == "'":
            end = script.find("'", self._at + 1)
            self._at = len(script) if end < 0 else end + 1
        elif character == '"':
            self._at += 1
            while self._at < len(script) and script[self._at] != '"':
                if script.startswith(("$(", "${", "\\"), self._at):
                    self._piece()
                else:
                    plain = _QUOTED.match(script, self._at)
                    self._at = plain.end() if plain else self._at + 1
            self._at += 1
        elif script.startswith(("$(", "${"), self._at):
            self._at += 1
            self._depth += 1
            if self._depth > _MOST_LEVELS:
                raise TooMuchError(f"nested more than {_MOST_LEVELS} levels deep")
            self._group(*("()" if script[self._at] == "(" else "{}"))
            self._depth -= 1
        elif character == "`":
            end = script.find("`", self._at + 1)
            self._at = len(script) if end < 0 else end + 1
        else:
            plain = _PLAIN.match(script, self._at)
            self._at = plain.end() if plain else self._at + 1

    def _group(self, opener: str, closer: str) -> None:
        """Move past a balanced group that starts here."""
        depth = 0
        while self._at < len(self._script):
            character = self._script[self._at]
            if character == opener:
                depth += 1
                self._at += 1
            elif character == closer:
                depth -= 1
                self._at += 1
                if depth == 0:
                    return
            elif character in "\\\"'`" or self._script.startswith(("$(", "${"), self._at):
                self._piece()
            else:
                self._at += 1

    def _skip_heredocs(self) -> None:
        for marker in self._heredocs:
            while self._at < len(self._script):
                end = self._script.find("\n", self._at)
                end = len(self._script) if end < 0 else end
                line = self._script[self._at : end].strip("\t ")
                self._at = end + 1
                if line == marker:
                    break
        self._heredocs = []

    def _line_of(self, offset: int) -> int:
        import bisect

        return bisect.bisect_right(self._line_starts, offset)
