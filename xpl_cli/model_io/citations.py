"""Citations of the authors' code in `CONVENTIONS`: the lines that they name, looked up in the source that is here.

found = lookup(Citation.parse("huggingface/lerobot@v0.4.4:src/lerobot/policies/utils.py:130 np.float32"), folders)
found.text, found.problem       # the lines; None, or that the symbol stands elsewhere
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from xpl_cli.basics import files
from xpl_cli.model_io import reading
from xpl_cli.packages.conventions import applying, declared
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl.manifest import Manifest
    from xpl_cli.packages.conventions import Value

_CITED = re.compile(
    r"(?P<path>[^\s:#]+)(?::|#L)(?P<first>[0-9]{1,7})(?:-L?(?P<last>[0-9]{1,7}))?(?![\w.])[\s,]*`?(?P<symbol>[A-Za-z_][\w.]*)?"
)
_FOREIGN = re.compile(r"@|://")
_MOST_BYTES = 4 << 20
_AROUND = 3
"""Lines before and after the cited ones that belong to them: a docstring, or what a statement goes on to."""
_LONGEST = 160
_ENVIRONMENTS = (".venv", "venv")
_SITE = ("lib/python3.*/site-packages", "lib64/python3.*/site-packages")


@dataclass(frozen=True)
class Citation:
    """A place in source code.

    Attributes:
        path: of the file, as it is cited, without what stands before it, such as a repository.
        first, last: lines, from 1, both included.
        symbol: name that is said to stand there, or "".
        is_foreign: whether it names a repository, not the package.
    """

    path: str
    first: int
    last: int
    symbol: str
    is_foreign: bool

    @classmethod
    def parse(cls, text: str) -> Self | None:
        """Return the citation in a source of a convention; None if it names no line of a file."""
        found = _CITED.search(text)
        if found is None:
            return None
        first = int(found["first"])
        last = max(first, int(found["last"] or first))
        return cls(
            found["path"], first, last, found["symbol"] or "", bool(_FOREIGN.search(text[: found.start("first")]))
        )


@dataclass(frozen=True)
class Quoted:
    """What stands at a citation.

    Attributes:
        file: where it was found.
        text: the cited lines, each without what indents it and cut to 160 characters.
        around: these, with three lines before and after.
        problem: what is wrong: no such line, nothing on it, the symbol elsewhere; None if nothing is.
    """

    file: Path
    text: tuple[str, ...]
    around: str
    problem: str | None


def folders(package: Path, python: str | None = None) -> tuple[Path, ...]:
    """Return the folders in which cited code may lie: the package, and what is installed beside an interpreter.

    Nothing is run to find them.

    Args:
        package: folder of the adapter.
        python: its interpreter. None: environments that lie in the package itself, and not where links lead to.
    """
    if python is not None:
        prefix = Path(python).parent.parent
        return package, *(place for pattern in _SITE for place in sorted(prefix.glob(pattern)))
    here = package.resolve()
    own = [place for name in _ENVIRONMENTS for pattern in _SITE for place in sorted(here.glob(f"{name}/{pattern}"))]
    return package, *(place for place in own if place.resolve().is_relative_to(here))


def lookup(citation: Citation, places: Sequence[Path]) -> Quoted | None:
    """Return what stands at a citation, None if the file is not here.

    Args:
        citation: of a file.
        places: of `folders`.
    """
    # What a repository calls data/env.py is not the package's own file of that name.
    file = _found(citation.path, places[1:] if citation.is_foreign else places)
    if file is None:
        return None
    lines = _lines(file)
    cited = lines[citation.first - 1 : citation.last]
    around = "\n".join(lines[max(0, citation.first - 1 - _AROUND) : citation.last + _AROUND])
    return Quoted(file, tuple(line.strip()[:_LONGEST] for line in cited), around, _problem(citation, lines, cited))


def contradiction(quoted: Quoted, values: Sequence[Value]) -> str | None:
    """Return how quoted code contradicts what is declared: it says another value's word, and none of the declared one.

    Args:
        quoted: the code.
        values: that the block declares for the convention.
    """
    said = set(re.findall(r"[a-z]+", quoted.around.lower().replace("2", " ")))
    for value in values:
        others = {other: words & said for other, words in _words(value.definition).items() if other != value.word}
        own = _words(value.definition).get(value.word, frozenset())
        contrary = sorted(word for words in others.values() for word in words)
        if own and not own & said and contrary:
            return f"the block says {value.word}, and the code says {contrary[0]}"
    return None


@cache
def _words(definition: str) -> dict[str, frozenset[str]]:
    """Return by value of a definition of the schema the words by which code says it."""
    options = spec.schema("model_io")["$defs"][definition]["oneOf"]
    return {one["const"]: frozenset(one["x-words"]) for one in options if "x-words" in one}


@dataclass(frozen=True)
class Cited:
    """A convention with what its source says.

    Attributes:
        convention: of the vocabulary.
        values: that the block gives it, of those that code names by one word.
        source: as reference.py has it; "" for a convention that applies and is not named.
        is_assumed: whether nobody was found to say it.
        file: where the cited lines were found; None if they were not.
        text: these lines.
        problem: what is wrong with them; None if nothing is known to be.
    """

    convention: str
    values: tuple[str, ...]
    source: str
    is_assumed: bool
    file: Path | None = None
    text: tuple[str, ...] = ()
    problem: str | None = None

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**vars(self), "file": None if self.file is None else str(self.file)}

    def lines(self) -> Iterator[str]:
        """Yield it for people."""
        value = f" = {', '.join(self.values)}" if self.values else ""
        yield f"{self.convention}{value}: {self.source or 'not named'}"
        yield from (f"    {line}" for line in self.text)
        if self.problem:
            yield f"    ! {self.problem}"
        elif not self.is_assumed and self.file is None:
            yield "    (the file is not here)"


def quoted(package: Path, manifest: Manifest, python: str | None) -> list[Cited]:
    """Return all conventions that reference.py names, or should, with the lines that it cites.

    Args:
        package: folder of the adapter.
        manifest: its policy.yml.
        python: its interpreter, beside which libraries are installed; None if there is none.

    Raises:
        UserError: reference.py is missing, or no Python.
    """
    known = reading.read_file(package)
    values = {} if manifest.model_io is None else declared(manifest.model_io)
    places = folders(package, python)
    return [_cited(name, known, values.get(name, ()), places) for name in known.agreed(applying(manifest))]


def _cited(name: str, known: reading.Reading, values: Sequence[Value], places: Sequence[Path]) -> Cited:
    told = known.conventions.get(name)
    words = tuple(dict.fromkeys(value.word for value in values))
    if told is None or told.is_assumed:
        return Cited(name, words, "" if told is None else told.text, is_assumed=True)
    citation = Citation.parse(told.text)
    if citation is None:
        return Cited(name, words, told.text, is_assumed=False, problem="it names no line of a file")
    found = lookup(citation, places)
    if found is None:
        return Cited(name, words, told.text, is_assumed=False)
    problem = found.problem or contradiction(found, values)
    return Cited(name, words, told.text, is_assumed=False, file=found.file, text=found.text, problem=problem)


def _found(path: str, places: Sequence[Path]) -> Path | None:
    """Return the file that a cited path means: repositories have folders above what is installed."""
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if ".." in parts:
        return None
    for start in range(max(1, len(parts) - 1)):
        for place in places:
            file = place.joinpath(*parts[start:])
            if file.is_file() and file.resolve().is_relative_to(place.resolve()):
                return file
    return None


@cache
def _lines(file: Path) -> list[str]:
    try:
        return files.content(file, _MOST_BYTES).decode("utf-8", errors="replace").splitlines()
    except OSError:
        return []


def _problem(citation: Citation, lines: Sequence[str], cited: Sequence[str]) -> str | None:
    if not 1 <= citation.first <= len(lines):
        return f"{citation.path} has {len(lines)} lines"
    name = citation.symbol.rpartition(".")[2]
    if name and _is_name(name) and not any(name in line for line in cited):
        where = [number for number, line in enumerate(lines, 1) if re.search(rf"\b{re.escape(name)}\b", line)]
        nearest = min(where, key=lambda number: abs(number - citation.first), default=None)
        told = "is nowhere in it" if nearest is None else f"stands at line {nearest}"
        return f"line {citation.first} of {citation.path} does not have {name}, which {told}"
    if not any(line.strip() for line in cited):
        return f"line {citation.first} of {citation.path} is empty"
    return None


def _is_name(word: str) -> bool:
    """Tell whether a word is a name of code, not of a sentence."""
    return "_" in word or any(char.isupper() for char in word[1:])
