"""Shell scripts as commands and words. Enough of the grammar to know who is called with what; nothing is executed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

_OPENERS: Final = frozenset(("while", "until", "for"))
_KEYWORDS: Final = frozenset(
    ("if", "then", "elif", "else", "do", "while", "until", "!", "{", "}", "fi", "done", "time")
)
_HEREDOC: Final = re.compile(r"<<-?\s*(['\"\\]?)([A-Za-z_]\w*)\1")
_REDIRECTION: Final = re.compile(r"<<<|[<>]+[&|]?[\d-]*")
_ASSIGNMENT: Final = re.compile(r"([A-Za-z_]\w*)\+?=(.*)", re.DOTALL)
_POSITION: Final = re.compile(r"""["']?\$(?:(\d)|\{(\d+)(?:[:#%/^,?+-][^}]*(?:\}[^}]*)*)?\})["']?""")


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
    """One simple command: its assignments, its words, and how deep in loops and functions it stands."""

    words: tuple[Word, ...]
    loops: int
    functions: int = 0

    @property
    def assignments(self) -> list[tuple[str, Word]]:
        """Names and values that the command assigns, of `export` and its like too."""
        words = self.words
        if words and words[0].text in {"export", "local", "readonly", "declare", "typeset"}:
            words = words[1:]
        found: list[tuple[str, Word]] = []
        for word in words:
            matched = _ASSIGNMENT.fullmatch(word.raw)
            if matched is None:
                break
            value = Word(matched.group(2), word.line, word.column + matched.start(2))
            found.append((matched.group(1), value))
        return found

    @property
    def arguments(self) -> tuple[Word, ...]:
        """The words after leading assignments: the program and what it gets."""
        for place, word in enumerate(self.words):
            if _ASSIGNMENT.fullmatch(word.raw) is None:
                return self.words[place:]
        return ()

    @property
    def name(self) -> str:
        """The program, without its folder; "" for a plain assignment."""
        return self.arguments[0].text.rpartition("/")[2] if self.arguments else ""


def parse(script: str) -> list[Command]:
    """Return the simple commands of a script, those of functions included and those of substitutions left out."""
    return _Parser(script).commands()


class _Parser:
    def __init__(self, script: str) -> None:
        self._script = script
        self._at = 0
        self._line_starts = [0, *(found.end() for found in re.finditer("\n", script))]
        self._found: list[Command] = []
        self._words: list[Word] = []
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
            self._end()
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
            self._end()
            self._at += 1
        else:
            self._word()

    def _end(self) -> None:
        words = self._words
        while words and words[0].raw in _KEYWORDS | _OPENERS:
            keyword = words.pop(0).raw
            self._loops += (keyword in _OPENERS) - (keyword == "done")
            if keyword == "{":
                self._blocks.append(self._is_function)
                self._is_function = False
            elif keyword == "}" and self._blocks:
                self._blocks.pop()
        if words and words[0].raw == "function":
            self._is_function = True
            self._blocks += [True] * (words[-1].raw == "{")
        elif words:
            self._found.append(Command(tuple(words), max(self._loops, 0), sum(self._blocks)))
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
                    self._at += 1
            self._at += 1
        elif script.startswith("$(", self._at):
            self._at += 1
            self._group("(", ")")
        elif script.startswith("${", self._at):
            self._at += 1
            self._group("{", "}")
        elif character == "`":
            end = script.find("`", self._at + 1)
            self._at = len(script) if end < 0 else end + 1
        else:
            self._at += 1

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
