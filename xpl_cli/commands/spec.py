"""`xpl spec`: show the standard, check documents and the standard itself, compile it for the SDK."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xpl_cli.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.problems import Problem

app = typer.Typer(help="Show, check and compile the standard.", no_args_is_help=True)

_JSON = typer.Option(False, "--json", help="Print a JSON object.")


@app.command()
def show(
    name: str | None = typer.Argument(
        None, metavar="[NAME]", help="A schema, embodiment, requirement, or part of the standard."
    ),
    as_json: bool = _JSON,
) -> None:
    """Show a part of the standard; without NAME, list what there is."""
    from xpl_cli import console, spec_view

    answer = spec_view.view(name)
    if as_json:
        console.data_json(answer.value)
    else:
        console.data(answer.text())


@app.command()
def validate(
    files: list[Path] | None = typer.Argument(
        None, metavar="[FILE]...", help="YAML or JSON files; none: the standard itself."
    ),
    schema: str | None = typer.Option(
        None, metavar="NAME", help="Schema to validate by; the file's name decides by default."
    ),
    as_json: bool = _JSON,
) -> None:
    """Check files against the standard, or the standard against itself."""
    from dataclasses import asdict

    from xpl_cli import console, spec_check

    problems = list(_file_problems(files, schema) if files else spec_check.check())
    if as_json:
        console.data_json({"schema": "xpl.spec-validate/1", "problems": [asdict(problem) for problem in problems]})
    elif problems:
        console.data("\n".join(map(str, problems)))
    else:
        console.data(f"{', '.join(map(str, files)) if files else 'the standard'}: valid")
    if problems:
        raise typer.Exit(ExitCode.FINDINGS)


@app.command("compile")
def compile_(
    check: bool = typer.Option(False, "--check", help="Write nothing; fail if the compiled file is out of date."),
) -> None:
    """Compile the standard into xpl/_spec.py, the constants of the SDK (in a checkout only)."""
    import xpl
    from xpl_cli import atomic, console
    from xpl_cli.content import room
    from xpl_cli.spec_compile import compile_source

    package = Path(xpl.__file__).resolve().parent
    target = package / "_spec.py"
    if room("spec").resolve().parent != package.parent:
        raise UserError("the standard is compiled in a checkout of xpl, and this xpl is an installed one")
    source = compile_source().encode()
    current = target.is_file() and target.read_bytes() == source
    if current:
        console.data(f"{target}: up to date")
    elif check:
        console.data(f"{target}: out of date; `xpl spec compile` renews it")
        raise typer.Exit(ExitCode.FINDINGS)
    else:
        atomic.write_file(target, source)
        console.data(f"{target}: written")


def _file_problems(files: list[Path], schema: str | None) -> Iterator[Problem]:
    """Yield the problems of each file by its schema."""
    from xpl_cli import spec
    from xpl_cli.errors import NotFoundError
    from xpl_cli.validate import validate_yaml_file

    known = spec.schema_names()
    if schema is not None and schema not in known:
        raise UserError(f"there is no schema {schema!r}: known are {', '.join(known)}")
    for file in files:
        chosen = schema or (file.stem if file.stem in known else None)
        if chosen is None and file.parent.name == "embodiments":
            chosen = "embodiment"
        if chosen is None:
            raise UserError(f"{file}: its name does not tell its schema", hint=f"--schema {'|'.join(known)}")
        if not file.is_file():
            raise NotFoundError(f"there is no file {file}")
        try:
            yield from validate_yaml_file(file, chosen)
        except OSError as error:
            raise UserError(f"{file} cannot be read: {error.strerror}") from None
