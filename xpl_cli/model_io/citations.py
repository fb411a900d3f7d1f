"""Citations of the authors' code: the lines that they name, looked up in the source that is here.

quotation = lookup(Citation.parse("huggingface/lerobot@v0.4.4:src/lerobot/policies/utils.py:130 np.float32"), folders)
quotation.text, quotation.problem       # the lines; None, or that the symbol stands elsewhere
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Self

from xpl_cli.basics import files
from xpl_cli.lifecycle.python_env import environments, sources
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.packages.conventions import DeclaredValue

_CITED = re.compile(
    r"(?P<path>[^\s:#]+)(?::|#L)(?P<first>[0-9]{1,7})(?:-L?(?P<last>[0-9]{1,7}))?(?![\w.])[\s,]*`?(?P<symbol>[A-Za-z_][\w.]*)?"
)
_FOREIGN = re.compile(r"@|://")
_MOST_BYTES = 4 << 20
_AROUND = 3
"""Lines before and after the cited ones that belong to them: a docstring, or what a statement goes on to."""
_LONGEST = 160
_ENVIRONMENTS = (".venv", "venv")
_SITE = ("lib/python3.*/site-packages", "lib64/python3.*/site-packages", "src/*")
"""Where an environment has packages, and repositories of `environment.sources`."""


@dataclass(frozen=True)
class Citation:
    """A place in source code.

    Attributes:
        path: of the file, as it is cited, without what stands before it, such as a repository.
        first, last: lines, from 1, both included.
        symbol: name that the citation expects there, or "".
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
        match = _CITED.search(text)
        if match is None:
            return None
        first = int(match["first"])
        last = max(first, int(match["last"] or first))
        return cls(
            match["path"], first, last, match["symbol"] or "", bool(_FOREIGN.search(text[: match.start("first")]))
        )


@dataclass(frozen=True)
class Quotation:
    """The source text at a citation.

    Attributes:
        file: the file found.
        text: the cited lines, each without what indents it and cut to 160 characters.
        around: these, with three lines before and after.
        problem: what is wrong: no such line, nothing on it, the symbol elsewhere; None if nothing is.
        start: number of the first line of `around`.
    """

    file: Path
    text: tuple[str, ...]
    around: str
    problem: str | None
    start: int = 1


def folders(package: Path, python: str | None = None) -> tuple[Path, ...]:
    """Return the folders in which cited code may lie: the package, and what is installed beside an interpreter.

    Nothing is run to find them.

    Args:
        package: folder of the adapter.
        python: its interpreter. None: environments that `xpl install` made, and not where other links lead to.
    """
    if python is not None:
        return package, *_installed(Path(python).parent.parent)
    resolved = package.resolve()
    site_folders = [folder for name in _ENVIRONMENTS for folder in _installed(resolved / name)]
    own = (resolved, environments.shared_folder().resolve())
    return package, *(folder for folder in site_folders if any(folder.resolve().is_relative_to(one) for one in own))


def _installed(environment: Path) -> Iterator[Path]:
    """Yield where an environment has packages and repositories, and the folders of these that are on its path."""
    folders = [folder for pattern in _SITE for folder in sorted(environment.glob(pattern))]
    yield from folders
    for folder in folders:
        if (folder / sources.ON_PATH).is_file():
            lines = (folder / sources.ON_PATH).read_text(encoding="utf-8", errors="replace").splitlines()
            yield from (path for path in map(Path, lines) if path.is_relative_to(environment.resolve()))


def lookup(citation: Citation, folders: Sequence[Path]) -> Quotation | None:
    """Return the source text at a citation, None if the file is missing.

    Args:
        citation: of a file.
        folders: of `folders`.
    """
    # data/env.py of a repository is not the package's own file of that name.
    file = _find_file(citation.path, folders[1:] if citation.is_foreign else folders)
    if file is None:
        return None
    lines = _lines(file)
    cited = lines[citation.first - 1 : citation.last]
    start = max(0, citation.first - 1 - _AROUND)
    around = "\n".join(lines[start : citation.last + _AROUND])
    text = tuple(line.strip()[:_LONGEST] for line in cited)
    return Quotation(file, text, around, _problem(citation, lines, cited), start + 1)


def contradiction(quoted: Quotation, values: Sequence[DeclaredValue]) -> str | None:
    """Return how quoted code contradicts declared values: it names another value, and not the declared one.

    Args:
        quoted: the code.
        values: that the block declares for the convention.
    """
    words_in_code = set(re.findall(r"[a-z]+", quoted.around.lower().replace("2", " ")))
    for value in values:
        others = {
            other: words & words_in_code
            for other, words in _code_words(value.definition).items()
            if other != value.value
        }
        own = _code_words(value.definition).get(value.value, frozenset())
        contrary = sorted(word for words in others.values() for word in words)
        if own and not own & words_in_code and contrary:
            return f"the block says {value.value}, and the code says {contrary[0]}"
    return None


@cache
def _code_words(definition: str) -> dict[str, frozenset[str]]:
    """Return by value of a definition of the schema the words by which code says it."""
    options = spec.schema("model_io")["$defs"][definition]["oneOf"]
    return {one["const"]: frozenset(one["x-words"]) for one in options if "x-words" in one}


def _find_file(path: str, folders: Sequence[Path]) -> Path | None:
    """Return the file that a cited path means: repositories have folders above what is installed."""
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if ".." in parts:
        return None
    for start in range(max(1, len(parts) - 1)):
        for folder in folders:
            file = folder.joinpath(*parts[start:])
            if file.is_file() and file.resolve().is_relative_to(folder.resolve()):
                return file
    return None


@cache
def _lines(file: Path) -> list[str]:
    try:
        return files.read_regular(file, _MOST_BYTES).decode("utf-8", errors="replace").splitlines()
    except OSError:
        return []


def _problem(citation: Citation, lines: Sequence[str], cited: Sequence[str]) -> str | None:
    if not 1 <= citation.first <= len(lines):
        return f"{citation.path} has {len(lines)} lines"
    name = citation.symbol.rpartition(".")[2]
    if name and _is_name(name) and not any(name in line for line in cited):
        where = [number for number, line in enumerate(lines, 1) if re.search(rf"\b{re.escape(name)}\b", line)]
        nearest = min(where, key=lambda number: abs(number - citation.first), default=None)
        elsewhere = "is nowhere in it" if nearest is None else f"stands at line {nearest}"
        return f"line {citation.first} of {citation.path} does not have {name}, which {elsewhere}"
    if not any(line.strip() for line in cited):
        return f"line {citation.first} of {citation.path} is empty"
    return None


def _is_name(word: str) -> bool:
    """Tell whether a word is a name of code, not of a sentence."""
    return "_" in word or any(char.isupper() for char in word[1:])
