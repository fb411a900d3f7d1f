"""`xpl spec`: show the standard, check documents and the standard itself, compile it for the SDK."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xpl_cli.basics.errors import ExitCode, UserError, no_such, one_of
from xpl_cli.commands.options import JSON

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.standard.problems import Problem

app = typer.Typer(help="Show, check and compile the standard.", no_args_is_help=True)

_TRAJECTORY = "trajectory"


@app.command()
def show(
    name: str | None = typer.Argument(
        None, metavar="[NAME]", help="A schema, embodiment, requirement, or part of the standard."
    ),
    as_json: bool = JSON,
) -> None:
    """Show a part of the standard; without NAME, list all parts."""
    from xpl_cli.basics import console
    from xpl_cli.packages import robots
    from xpl_cli.standard import spec, view

    robots.register_robots()
    answer = view.view(name)
    if as_json:
        following = ["xpl spec show policy"] if name is None else []
        console.answer("xpl.spec-show/1", {"version": spec.VERSION, "name": name, "value": answer.value}, following)
    else:
        console.data(answer.text())


@app.command()
def validate(
    files: list[Path] | None = typer.Argument(
        None, metavar="[FILE]...", help="YAML, JSON or HDF5 files; none: the standard itself."
    ),
    schema: str | None = typer.Option(
        None, metavar="NAME", help="Schema to validate by; the file's name decides by default."
    ),
    as_json: bool = JSON,
) -> None:
    """Check files against the standard, or the standard against itself."""
    from xpl_cli.basics import console
    from xpl_cli.standard.check import check_all
    from xpl_cli.standard.problems import problem_json

    problems = list(_file_problems(files, schema) if files else check_all())
    if as_json:
        answer = {"problems": [problem_json(problem) for problem in problems]}
        keys = dict.fromkeys(f"xpl spec show {_schema_of(file, schema)}" for file in files or ())
        console.answer("xpl.spec-validate/1", answer, list(keys) if problems else [])
    elif problems:
        console.data("\n".join(map(str, problems)))
    else:
        console.data(f"{', '.join(map(str, files)) if files else 'the standard'}: valid")
    if problems:
        raise typer.Exit(ExitCode.FINDINGS)


@app.command()
def check(as_json: bool = JSON) -> None:
    """Check the standard against itself, with the robots and the zoo."""
    validate(None, schema=None, as_json=as_json)


@app.command("compile")
def compile_(
    context: typer.Context,
    check: bool = typer.Option(False, "--check", help="Write nothing; fail if something is out of date."),
    as_json: bool = JSON,
) -> None:
    """Generate the SDK's constants, and the pages on standard, rules and commands (in a checkout only)."""
    from xpl_cli.basics import atomic, console
    from xpl_cli.derived import compiler

    root = _checkout()
    files = compiler.generated_files(context.find_root().command)
    old = [name for name, content in files.items() if not _holds(root / name, content)]
    left_over = compiler.obsolete_pages(root)
    for name in old if not check else ():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        atomic.write_file(root / name, files[name])
    for name in left_over if not check else ():
        (root / name).unlink()
    states = {
        name: "out of date" if check else "removed" if name in left_over else "written" for name in [*old, *left_over]
    }
    if as_json:
        entries = [{"name": name, "state": state} for name, state in states.items()]
        following = ["xpl spec compile"] if check and states else []
        console.answer("xpl.spec-compile/1", {"derived": len(files), "files": entries}, following)
    elif states:
        renews = "; `xpl spec compile` renews it" if check else ""
        console.data("\n".join(f"{name}: {state}{renews}" for name, state in states.items()))
    else:
        console.data(f"{len(files)} files: up to date")
    if check and states:
        raise typer.Exit(ExitCode.FINDINGS)


@app.command()
def schemas(
    folders: list[Path] | None = typer.Argument(
        None, metavar="[FOLDER]...", help="Packages whose manifests editors shall complete; none: print one schema."
    ),
    name: str = typer.Option("policy", "--schema", metavar="NAME", help="Schema to print."),
    as_json: bool = JSON,
) -> None:
    """Write JSON Schemas into packages, by which editors complete and check deploy.yml, policy.yml and env.yml."""
    from xpl import json_text
    from xpl_cli.basics import console
    from xpl_cli.standard import spec
    from xpl_cli.standard.schemas import render, write

    document: bytes | None = None
    written: list[str] = []
    if not folders:
        one_of("--schema", name, spec.schema_names())
        document = render(name)
    for folder in folders or ():
        written += [str(folder / file) for file in write(folder)]
    if as_json:
        answer = {"written": written, "document": None if document is None else json_text.parse(document)}
        console.answer("xpl.spec-schemas/1", answer)
    elif document is not None:
        console.data(document.decode())
    elif written:
        console.data("\n".join(f"{file}: written" for file in written))


def _checkout() -> Path:
    """Return the folder of the checkout that this tool runs from.

    Raises:
        UserError: if it is an installed one.
    """
    import xpl
    from xpl_cli.basics.content import content_folder

    package = Path(xpl.__file__).resolve().parent
    if content_folder("spec").resolve().parent != package.parent:
        raise UserError("the standard is changed in a checkout of xpl, and this xpl is an installed one")
    return package.parent


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


def _file_problems(files: list[Path], schema: str | None) -> Iterator[Problem]:
    """Yield the problems of each file by its schema."""
    from xpl_cli.basics.errors import NotFoundError
    from xpl_cli.standard.validate import validate_yaml_file

    for file in files:
        chosen = _schema_of(file, schema)
        if not file.is_file():
            raise NotFoundError(f"there is no file {file}")
        if chosen == _TRAJECTORY:
            from xpl_cli.data.sets import trajectory_schema

            yield from trajectory_schema.schema_problems(file)
            continue
        if chosen == "embodiment":  # which may be like another one: what counts is the whole
            from xpl import robots as sdk_robots
            from xpl_cli.packages.manifests import content_of
            from xpl_cli.standard import robots

            yield from robots.read(content_of(file) or b"", str(file), sdk_robots.entries())[1]
            continue
        try:
            yield from validate_yaml_file(file, chosen)
        except OSError as error:
            raise UserError(f"{file} cannot be read: {error.strerror}") from None


def _schema_of(file: Path, schema: str | None) -> str:
    """Return the name of the requested schema, or the one that a file's name implies.

    Raises:
        UserError: if there is none of that name, or the name tells none.
    """
    from xpl_cli.standard import spec

    names = spec.schema_names()
    if schema is not None:
        if schema not in names:
            raise no_such(f"there is no schema {schema!r}", schema, names)
        return schema
    implied = "embodiment" if file.parent.name == "embodiments" else file.stem
    implied = _TRAJECTORY if file.suffix in (".hdf5", ".h5") else implied
    if implied not in names:
        raise UserError(f"{file}: its name does not determine its schema", hint=f"--schema {'|'.join(names)}")
    return implied
