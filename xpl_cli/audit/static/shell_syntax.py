"""Whether bash would take a script: what is opened is closed, and no word of the grammar stands where none may.

Only what bash is sure to refuse is told. Where a script uses what is not understood here, nothing is said of it; the
tests hold every refusal against bash itself.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

_MOST_LEVELS: Final = 100
_BLANK: Final = " \t"
_META: Final = " \t\n;&|<>()"
_OPERATOR: Final = re.compile(r";;&|;;|;&|&&|\|\||\|&|;|&|\|")
_REDIRECTION: Final = re.compile(r"<<<|&>>?|<>|>>|>\||[<>]&|[<>]")
_CLOSERS: Final = {"if": "fi", "loop": "done", "case": "esac", "{": "}", "(": ")"}
_OPENS: Final = {"fi": "if", "done": "loop", "esac": "case", "}": "{"}
_GOES_ON: Final = {
    "then": ("if", "condition", "then"),
    "elif": ("if", "then", "condition"),
    "else": ("if", "then", "else"),
    "do": ("loop", "condition", "body"),
}
"""What each of these needs to be open, in which part, and the part that it begins."""
_LOOPS: Final = frozenset(("while", "until", "for", "select"))


class BrokenScriptError(ValueError):
    """Bash refuses the script.

    Args:
        problem: what is wrong.
        line: where, from 1.
    """

    def __init__(self, problem: str, line: int) -> None:
        super().__init__(problem)
        self.line = line


class _Unsure(Exception):  # noqa: N818 - nothing is wrong
    """The script uses what is not understood here."""


@dataclass
class _Open:
    """What was opened and is to be closed."""

    kind: str
    word: str
    line: int
    part: str = ""


def check(script: str) -> None:
    """Read a script.

    Raises:
        BrokenScriptError: if bash refuses it.
    """
    try:
        _Reader(script).all()
    except _Unsure:
        return


class _Reader:
    def __init__(self, script: str) -> None:
        self._text = script
        self._at = 0
        self._depth = 0
        self._heredocs: list[tuple[str, bool]] = []

    def all(self) -> None:
        if "\r" in self._text or "alias" in self._text or "extglob" in self._text:
            raise _Unsure
        self._commands("")

    # -- commands ------------------------------------------------------------------------------------------------------

    def _commands(self, closer: str) -> None:
        """Read commands up to the end, or up to the parenthesis that closes them."""
        open_: list[_Open] = []
        begins = True  # whether a command may begin here
        start = self._line()
        while self._at < len(self._text):
            if self._skipped():
                continue
            if open_ and open_[-1].part == "pattern":
                begins = self._pattern(open_)
            elif self._text[self._at] == ")" and closer and not open_:
                self._at += 1
                return
            else:
                begins = self._part(open_, begins=begins)
        if open_:
            raise BrokenScriptError(f"{open_[-1].word} has no {_CLOSERS[open_[-1].kind]}", open_[-1].line)
        if closer:
            raise BrokenScriptError("a parenthesis is not closed", start)

    def _part(self, open_: list[_Open], *, begins: bool) -> bool:
        """Read an operator, a redirection or a word; return whether a command may begin behind it."""
        character = self._text[self._at]
        if character in "()":
            return self._parenthesis(open_, begins=begins)
        if character == "\n":
            self._newline()
            return True
        if _REDIRECTION.match(self._text, self._at):
            self._redirection()
            return False
        if operator := _OPERATOR.match(self._text, self._at):
            self._at = operator.end()
            if operator.group() in {";;", ";&", ";;&"}:
                if not open_ or open_[-1].kind != "case":
                    raise BrokenScriptError(f"{operator.group()} outside of a case", self._line())
                open_[-1].part = "pattern"
            return True
        return self._worded(open_, begins=begins)

    def _parenthesis(self, open_: list[_Open], *, begins: bool) -> bool:
        if self._text[self._at] == ")":
            if not open_ or open_[-1].kind != "(":
                raise BrokenScriptError(self._misplaced(")", open_), self._line())
            open_.pop()
            self._at += 1
        elif not begins:
            raise _Unsure  # a pattern, or what only some shells take
        elif self._text.startswith("((", self._at):
            self._arithmetic()
        else:
            open_.append(_Open("(", "(", self._line()))
            self._at += 1
        return True

    def _worded(self, open_: list[_Open], *, begins: bool) -> bool:
        """Read a word; return whether a command may begin behind it."""
        line, word = self._line(), self._word()
        after = re.compile(r"[ \t]*\([ \t]*\)").match(self._text, self._at)
        if begins and after is not None and word not in _CLOSERS.values():
            self._at = after.end()
            return True
        if self._text.startswith("(", self._at):
            raise _Unsure
        return self._reserved(word, line, open_) if begins else False

    def _reserved(self, word: str, line: int, open_: list[_Open]) -> bool:
        """Take a word at the beginning of a command for what the grammar takes it."""
        if word in {"function", "coproc", "in", "]]"}:
            raise _Unsure
        if word in _LOOPS:
            return self._loop(word, line, open_)
        if word in {"if", "{"}:
            open_.append(_Open(word, word, line, "condition" if word == "if" else ""))
        elif word == "case":
            self._case(open_, line)
        elif word == "[[":
            self._test()
        elif word in _OPENS or word in _GOES_ON:
            self._goes_on(word, line, open_)
        else:
            return word in {"!", "time"}
        return True

    def _loop(self, word: str, line: int, open_: list[_Open]) -> bool:
        open_.append(_Open("loop", word, line, "condition"))
        if word in {"while", "until"}:
            return True
        self._blanks()
        if self._text.startswith("((", self._at):
            self._arithmetic()
            return True
        self._word()
        return self._follows("do")

    def _goes_on(self, word: str, line: int, open_: list[_Open]) -> None:
        """Take a word that closes or continues what is open."""
        top = open_[-1] if open_ else _Open("", "", line)
        if word in _OPENS:
            if top.kind != _OPENS[word] or top.part == "condition":
                raise BrokenScriptError(self._misplaced(word, open_), line)
            open_.pop()
            return
        kind, before, part = _GOES_ON[word]
        if (top.kind, top.part) != (kind, before):
            raise BrokenScriptError(self._misplaced(word, open_), line)
        top.part = part

    def _misplaced(self, word: str, open_: list[_Open]) -> str:
        if not open_:
            return f"{word} closes nothing, or continues nothing, that is open"
        return f"{word} stands where {open_[-1].word} (line {open_[-1].line}) is open"

    def _case(self, open_: list[_Open], line: int) -> None:
        self._blanks()
        self._word()
        while self._at < len(self._text) and (self._skipped() or self._text[self._at] == "\n"):
            if self._text.startswith("\n", self._at):
                self._newline()
        if self._word() != "in":
            raise _Unsure
        open_.append(_Open("case", "case", line, "pattern"))

    def _pattern(self, open_: list[_Open]) -> bool:
        """Read the patterns of a clause, or `esac`; return that a command may begin behind them."""
        if self._text[self._at] == "\n":
            self._newline()
            return True
        if self._text[self._at] == "(":
            self._at += 1
        elif self._word() == "esac":
            open_.pop()
            return True
        while self._at < len(self._text) and self._text[self._at] != ")":
            if self._text[self._at] in "\n;&<>(":
                raise _Unsure
            if self._text[self._at] in " \t|":
                self._at += 1
            else:
                self._word()
        self._at += 1
        open_[-1].part = "body"
        return True

    def _test(self) -> None:
        """Move past `[[ ]]`, whose words have a grammar of their own."""
        try:
            while self._at < len(self._text) and self._text[self._at] not in ";\n":
                if self._skipped():
                    continue
                if self._text[self._at] in _META:
                    self._at += 1
                elif self._word() == "]]":
                    return
        except BrokenScriptError:
            raise _Unsure from None
        raise _Unsure

    def _redirection(self) -> None:
        found = re.compile(r"<<(-?)[ \t]*(?=[^<\s])").match(self._text, self._at)
        if found is not None and not self._text.startswith("<<<", self._at):
            self._at = found.end()
            self._heredocs.append((re.sub(r"[\\'\"]", "", self._word()), bool(found.group(1))))
            return
        if self._text.startswith(("<(", ">("), self._at):
            self._at += 2
            self._nested()
            return
        self._at += len(match.group()) if (match := _REDIRECTION.match(self._text, self._at)) else 1
        self._blanks()
        self._word()

    def _newline(self) -> None:
        """Move past a line end, and past the documents that begin behind it."""
        self._at += 1
        for marker, strips in self._heredocs:
            while True:
                if self._at >= len(self._text):
                    raise _Unsure  # bash only warns
                end = self._text.find("\n", self._at)
                end = len(self._text) if end < 0 else end
                line = self._text[self._at : end]
                self._at = end + 1
                if (line.lstrip("\t") if strips else line) == marker:
                    self._at -= 1  # the line end is one of the commands
                    break
            self._at += 1
        self._heredocs = []

    # -- words ---------------------------------------------------------------------------------------------------------

    def _word(self) -> str:
        """Return a word as it is written; empty where none stands."""
        start = self._at
        while self._at < len(self._text) and self._text[self._at] not in _META:
            self._piece()
            if self._text.startswith("(", self._at) and self._text[self._at - 1] == "=":
                self._at += 1
                self._array()
        if self._at == start and self._at < len(self._text) and self._text[self._at] not in _META:
            raise _Unsure
        return self._text[start : self._at]

    def _piece(self) -> None:
        character = self._text[self._at]
        if character == "\\":
            self._at += 2
        elif character == "'":
            self._until("'", "a single quote")
        elif self._text.startswith("$'", self._at):
            self._at += 1
            self._until("'", "a single quote", escapes=True)
        elif character == '"':
            self._quoted()
        elif character == "`":
            self._until("`", "a backquote", escapes=True)
        elif self._text.startswith("$((", self._at):
            self._at += 1
            self._arithmetic()
        elif self._text.startswith("$(", self._at):
            self._at += 2
            self._nested()
        elif self._text.startswith("${", self._at):
            self._braced(quoted=False)
        elif self._text.startswith("$[", self._at):
            raise _Unsure
        else:
            self._at += 1

    def _until(self, end: str, what: str, *, escapes: bool = False) -> None:
        line = self._line()
        self._at += 1
        while self._at < len(self._text):
            if self._text[self._at] == end:
                self._at += 1
                return
            self._at += 2 if escapes and self._text[self._at] == "\\" else 1
        raise BrokenScriptError(f"{what} is not closed", line)

    def _quoted(self) -> None:
        line = self._line()
        self._at += 1
        while self._at < len(self._text):
            if self._text[self._at] == '"':
                self._at += 1
                return
            if self._text.startswith("${", self._at):
                self._braced(quoted=True)
            elif self._text[self._at] in "\\`" or self._text.startswith("$(", self._at):
                self._piece()
            else:
                self._at += 1
        raise BrokenScriptError("a double quote is not closed", line)

    def _braced(self, *, quoted: bool) -> None:
        line = self._line()
        self._deeper()
        self._at += 2
        while self._at < len(self._text):
            if self._text[self._at] == "}":
                self._at += 1
                self._depth -= 1
                return
            if self._text[self._at] == "'" and quoted:
                self._at += 1
            elif self._text.startswith("${", self._at):
                self._braced(quoted=quoted)
            else:
                self._piece()
        raise BrokenScriptError("${ is not closed", line)

    def _nested(self) -> None:
        self._deeper()
        outer, self._heredocs = self._heredocs, []
        self._commands(")")
        self._heredocs = outer
        self._depth -= 1

    def _array(self) -> None:
        line = self._line()
        while self._at < len(self._text):
            if self._text[self._at] == ")":
                self._at += 1
                return
            if self._skipped():
                continue
            if self._text[self._at] == "\n":
                self._newline()
            elif self._text[self._at] in _META:
                raise _Unsure
            else:
                self._word()
        raise BrokenScriptError("the parenthesis of an array is not closed", line)

    def _arithmetic(self) -> None:
        """Move past `(( ))`; what may as well be a subshell in another is not understood."""
        depth = 0
        while self._at < len(self._text):
            character = self._text[self._at]
            depth += (character == "(") - (character == ")")
            if character == ")" and depth == 1 and not self._text.startswith("))", self._at):
                raise _Unsure
            if character == "'":
                raise _Unsure
            if character in '"`\\' or self._text.startswith(("$(", "${"), self._at):
                self._piece()
            else:
                self._at += 1
            if depth == 0:
                return
        raise _Unsure

    # -- where ---------------------------------------------------------------------------------------------------------

    def _skipped(self) -> bool:
        text, at = self._text, self._at
        if text[at] in _BLANK:
            self._at += 1
        elif text.startswith("\\\n", at):
            self._at += 2
        elif text[at] == "#":
            end = text.find("\n", at)
            self._at = len(text) if end < 0 else end
        else:
            return False
        return True

    def _blanks(self) -> None:
        while self._at < len(self._text) and self._text[self._at] in _BLANK:
            self._at += 1

    def _follows(self, word: str) -> bool:
        self._blanks()
        return re.compile(rf"{word}(?=[\s;&|()]|$)").match(self._text, self._at) is not None

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > _MOST_LEVELS:
            raise _Unsure

    def _line(self) -> int:
        return self._text.count("\n", 0, self._at) + 1
