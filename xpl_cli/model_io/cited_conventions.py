"""Conventions with their values in the block and the lines of the authors' code that reference.py cites for them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.basics.errors import UserError
from xpl_cli.lifecycle import interpreter
from xpl_cli.model_io import reference_file
from xpl_cli.model_io.citations import Citation, contradiction, folders, lookup
from xpl_cli.model_io.statements import Certainty, Statement, statements
from xpl_cli.packages.conventions import applicable_conventions, declared_values

if TYPE_CHECKING:
    from xpl_cli.model_io.citations import Quotation
    from xpl_cli.model_io.reference_file import ConventionSource, ReferenceFile
    from xpl_cli.packages.conventions import DeclaredValue
    from xpl_cli.packages.package import Package

_MOST_LINES: Final = 60
_WIDEST: Final = 200


@dataclass(frozen=True)
class SourceLine:
    """A line of the authors' code.

    Attributes:
        number: in its file, from 1.
        text: as it stands there, cut to 200 characters.
        is_cited: whether the citation names it, or it only stands around.
    """

    number: int
    text: str
    is_cited: bool


@dataclass(frozen=True)
class CitedConvention:
    """A convention with the lines of its source.

    Attributes:
        convention: of the vocabulary.
        values: that the block gives it, of those that code names by one word.
        source: as reference.py has it; "" for a convention that applies and is not named.
        is_assumed: whether it has no source.
        declared: all that the block says of it.
        file: where the cited lines were found; None if they were not.
        lines: these lines, and those around them.
        problem: what is wrong with them; None if nothing is known to be.
    """

    convention: str
    values: tuple[str, ...]
    source: str
    is_assumed: bool
    declared: tuple[Statement, ...] = ()
    file: Path | None = None
    lines: tuple[SourceLine, ...] = ()
    problem: str | None = None

    @property
    def meaning(self) -> str:
        """The meaning of the convention."""
        return reference_file.vocabulary()[self.convention]

    @property
    def standing(self) -> Certainty:
        """Unknown where the block leaves a value open, assumed where it or the source assumes, else known."""
        certainties = [
            Certainty.ASSUMED if self.is_assumed else Certainty.KNOWN,
            *(one.standing for one in self.declared),
        ]
        return max(certainties, key=list(Certainty).index)

    @property
    def text(self) -> list[str]:
        """The cited lines, without what indents them."""
        return [line.text.strip() for line in self.lines if line.is_cited]

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            **vars(self),
            "standing": self.standing,
            "declared": [one.document() for one in self.declared],
            "file": None if self.file is None else str(self.file),
            "lines": [asdict(line) for line in self.lines],
            "text": self.text,
        }

    def format_lines(self) -> Iterator[str]:
        """Yield it for people."""
        value = f" = {', '.join(self.values)}" if self.values else ""
        yield f"{self.convention}{value}: {self.source or 'not named'}"
        yield from (f"    {line}" for line in self.text)
        if self.problem:
            yield f"    ! {self.problem}"
        elif not self.is_assumed and self.file is None:
            yield "    (the file is not here)"


def cite_conventions(
    package: Package, reference: ReferenceFile, python: str | None = None, env: str | None = None
) -> list[CitedConvention]:
    """Return all conventions that reference.py names, or should, with the lines that it cites.

    Args:
        package: the adapter.
        reference: its reference.py; an empty one names no source.
        python: its interpreter, beside which libraries are installed; by default its own, where there is one.
        env: conda environment of that.

    Raises:
        UserError: if an interpreter that was named is missing.
    """
    manifest = package.manifest
    values = {} if manifest.model_io is None else declared_values(manifest.model_io)
    statements_by_convention = statements(manifest)
    folders_searched = folders(package.path, _python(package, python, env))
    cited = []
    for name in reference.all_conventions(applicable_conventions(manifest)):
        words = tuple(dict.fromkeys(value.value for value in values.get(name, ())))
        one = CitedConvention(name, words, "", is_assumed=True, declared=statements_by_convention.get(name, ()))
        if name in reference.conventions:
            one = _look_up_source(one, reference.conventions[name], values.get(name, ()), folders_searched)
        cited.append(one)
    return cited


def _look_up_source(
    one: CitedConvention, source: ConventionSource, values: Sequence[DeclaredValue], folders: Sequence[Path]
) -> CitedConvention:
    """Return a convention that reference.py names, with the lines that it cites."""
    one = replace(one, source=source.text, is_assumed=source.is_assumed)
    citation = None if one.is_assumed else Citation.parse(source.text)
    if citation is None:
        return one if one.is_assumed else replace(one, problem="it names no line of a file")
    quotation = lookup(citation, folders)
    if quotation is None:
        return one
    problem = quotation.problem or contradiction(quotation, values)
    return replace(one, file=quotation.file, lines=tuple(_lines(quotation, citation)), problem=problem)


def _lines(quotation: Quotation, citation: Citation) -> Iterator[SourceLine]:
    for number, text in list(enumerate(quotation.around.split("\n"), quotation.start))[:_MOST_LINES]:
        yield SourceLine(number, text[:_WIDEST].rstrip(), citation.first <= number <= citation.last)


def _python(package: Package, python: str | None, env: str | None) -> str | None:
    """Return the interpreter of a package; None where it is not installed: what lies in the package is quoted."""
    try:
        return interpreter.resolve(package.path, package.manifest.environment, python=python, env=env)
    except UserError:
        if python is not None or env is not None:
            raise
        return None
