"""Renders a package from a template and puts it in place in one step.

A template gets everything it says from the spec. A render is a plain map from file names to contents: what `xpl
new-policy` writes is what an update merges later.
"""

from __future__ import annotations

import keyword
import re
import sys
import unicodedata
from contextlib import contextmanager
from dataclasses import MISSING, asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from xpl import _spec as sdk
from xpl import robots
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError, one_of
from xpl_cli.packages.package import POLICY
from xpl_cli.scaffold import context, kinds, lock
from xpl_cli.scaffold import template as templates
from xpl_cli.scaffold.answers import Answers
from xpl_cli.standard import schemas, spec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from xpl_cli.scaffold.template import Files

_REFERENCE = spec.data("package")["files"]["reference"]
"""The file that is written only where it was asked for."""

State = Literal["written", "unchanged", "replaced"]

# Whoever puts the folder above an adapter on `sys.path`, as launchers do, gets the adapter instead of these.
_SHADOWED = frozenset((*sys.stdlib_module_names, "numpy", "xpl", "xpl_cli"))


@dataclass(frozen=True)
class Placeholder:
    """A place in a rendered file that its author still has to fill in."""

    file: str
    line: int
    text: str


def defaults() -> dict[str, Any]:
    """Return the default answers: those of the spec, and the template's own where the spec leaves the choice open."""
    questions = templates.questions(POLICY)
    temporal = spec.schema("policy")["properties"]["temporal"]["properties"]
    settings = spec.schema("deploy")["properties"] | temporal
    of_spec = {key: settings[key]["default"] for key in questions if "default" in settings.get(key, ())}
    return of_spec | {key: entry["default"] for key, entry in questions.items() if "default" in entry}


def choices() -> dict[str, list[str]]:
    """Return the answers that the spec allows, for the questions where it lists them."""
    return {
        "embodiment": list(robots.entries()),
        sdk.Deploy.ACTION_TYPE: list(spec.data("conventions")["action"]["types"]),
        "family": list(spec.schema("policy")["properties"]["family"]["enum"]),
    }


def check(answers: Answers) -> None:
    """Check all answers.

    Raises:
        UserError: with every answer that is not allowed, and the nearest ones that are.
    """
    found: list[UserError] = []
    for refuse in _checks(answers):
        try:
            refuse()
        except UserError as error:
            found.append(error)
    if len(found) > 1:
        told = [f"{error} ({error.hint})" if error.hint else str(error) for error in found]
        raise UserError("; ".join(told), hint="all of them at once: mend each and run it again")
    if found:
        raise found[0]


def _checks(answers: Answers) -> Iterator[Callable[[], None]]:
    """Yield a check for each thing that may be wrong with answers."""
    yield partial(check_name, answers.name)
    for question, allowed in choices().items():
        yield partial(check_choice, _option(question), getattr(answers, question), allowed)
    yield partial(kinds.check_kind, answers.kind)
    if answers.kind in kinds.kinds():
        for question in _chosen(answers):
            yield partial(kinds.check_fits, answers.kind, question)
    for question in ("chunk", "history"):
        yield partial(_check_count, question, getattr(answers, question))
    yield partial(kinds.check_ensembling, answers.ensembling, answers.chunk)
    if answers.embodiment in robots.entries():
        yield partial(kinds.check_cameras, answers.cameras, answers.embodiment)
    yield partial(kinds.check_python, answers.python)


def _check_count(question: str, given: int) -> None:
    if given < 1:
        raise UserError(f"{_option(question)} must be at least 1, got {given}")


def _option(question: str) -> str:
    return f"--{question.replace('_', '-')}"


def check_choice(option: str, given: str, allowed: Sequence[str]) -> None:
    """Check that an answer is one of those allowed.

    Raises:
        UnknownNameError: with the nearest one.
    """
    one_of(option, given, allowed)


def check_name(name: str) -> None:
    """Check that a package of this name can be imported and hides no other.

    Raises:
        UserError: with a name that would do.
    """
    identifier = spec.schema("common")["$defs"]["identifier"]["pattern"]
    if re.fullmatch(identifier, name) is None:
        why = "a name starts with a letter or underscore, and goes on with letters, digits and underscores (ASCII)"
    elif keyword.iskeyword(name):
        why = "it is a keyword of Python"
    elif name in _SHADOWED:
        why = f"it would hide the Python module {name}"
    elif name.startswith("__"):
        why = "names with two leading underscores are Python's own"
    elif len(name) > 100:
        why = f"it has {len(name)} characters, and 100 are the most"
    else:
        return
    raise UserError(f"{name!r} cannot name a package: {why}", hint=f"a name that would do: {suggest_name(name)}")


def suggest_name(name: str) -> str:
    """Return the nearest name that `check_name` accepts."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    words = re.sub(r"\W+", "_", ascii_name).strip("_")[:90] or "my_policy"
    if words[0].isdigit():
        words = f"policy_{words}"
    return f"{words}_policy" if keyword.iskeyword(words) or words in _SHADOWED else words


def render(answers: Answers) -> Files:
    """Render the template of adapters; the same answers always give the same bytes.

    Returns:
        file name, relative to the package, to content; sorted.
    """
    training = spec.data("package")["files"]["training"]
    said = context.context(answers)
    leave_out = [*(training if said["evaluation_only"] else ()), *([] if answers.reference else [_REFERENCE])]
    files = templates.render(POLICY, said, leave_out, answers.kind)
    return locked(files, POLICY, asdict(answers))


def locked(files: Files, template: str, answers: Mapping[str, Any]) -> Files:
    """Return a render with what xpl keeps in the package: schemas for editors, the lock, and the render itself."""
    roles = templates.roles(template)
    for_editors = {schemas.path(name): schemas.render(name) for name in roles["schemas"]}
    whole = {**files, **for_editors}
    generated = [name for name in whole if name in roles["generated"] or name in for_editors]
    kept = lock.Lock(template, answers, {name: lock.digest(whole[name]) for name in generated})
    whole |= {lock.PATH: kept.text().encode(), lock.RENDERED: lock.rendered_text(files)}
    return dict(sorted(whole.items()))


def answers_of(**given: Any) -> Answers:
    """Return answers from what a lock or a command line holds."""
    return Answers(**{**given, "cameras": tuple(given.get("cameras") or ())})


def recorded(kept: lock.Lock) -> Answers:
    """Return the answers of a package that was scaffolded; what its template did not ask then has the default.

    Raises:
        UserError: if they are not answers.
    """
    with reading_answers("a package"):
        answers = answers_of(**given(kept, Answers, defaults()))
        check(answers)
    return answers


def given(kept: lock.Lock, form: type[Any], usual: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a lock says of the fields of a form, and the usual values of the others."""
    names = {field.name for field in fields(form)}
    return {**usual, **{key: value for key, value in kept.answers.items() if key in names}}


@contextmanager
def reading_answers(kind: str) -> Iterator[None]:
    """Say that recorded answers are not those of a kind of package where they do not even have its types.

    Raises:
        UserError: if they have not.
    """
    try:
        yield
    except (TypeError, AttributeError) as error:
        raise UserError(f"the recorded answers are not those of {kind}: {error}") from None


def needs_environment(answers: Answers) -> bool:
    """Tell whether the package runs in a Python of its own."""
    return bool(kinds.kinds()[answers.kind].python(answers.python)["manager"] != kinds.TOOLS_OWN)


def placeholders(files: Mapping[str, bytes]) -> list[Placeholder]:
    """Return every place that is marked for the author, in the order of files and lines."""
    marker = re.compile(rf"{re.escape(spec.data('package')['placeholder'])}:\s*(.+)")
    return [
        Placeholder(name, number, found.group(1).rstrip(" |"))
        for name, content in files.items()
        if not name.startswith(f"{schemas.FOLDER}/")
        for number, line in enumerate(content.decode().splitlines(), start=1)
        if (found := marker.search(line))
    ]


def differences(files: Mapping[str, bytes], target: Path) -> list[str]:
    """Return the names of the rendered files that `target` lacks or holds otherwise."""
    return [name for name, content in files.items() if not _is_file_with(target / name, content)]


def write(files: Mapping[str, bytes], target: Path, *, overwrite: bool = False) -> State:
    """Put a render in place: the whole package appears in one step, or nothing does.

    Args:
        files: the render.
        target: folder of the package.
        overwrite: replace files that differ. Files of the author's that the template does not know are kept.

    Raises:
        UserError: if `target` holds something else and `overwrite` is false, or cannot be written.
    """
    target = target.resolve()
    exists = target.exists()
    if exists and not target.is_dir():
        raise UserError(f"{target} is a file: expected a folder, or nothing, where the package goes")
    changed = differences(files, target)
    if not changed:
        return "unchanged"
    taken = exists and any(target.iterdir())
    if taken and not overwrite:
        raise UserError(
            f"{target} is there already and differs from the template in {len(changed)} files: {', '.join(changed)}",
            hint="choose another name, or replace these files with --overwrite (files of your own are kept)",
        )
    try:
        with atomic.replaced_folder(target) as staging:
            for name, content in files.items():
                path = staging / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
                path.chmod(0o755 if path.suffix == ".sh" else 0o644)
            if taken:
                _keep_others(target, staging)
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        raise UserError(f"{target} cannot be written: {error.strerror or error}{where}") from None
    return "replaced" if taken else "written"


def _keep_others(old: Path, new: Path) -> None:
    """Carry what the author added from the old folder over to the new one."""
    for entry in old.iterdir():
        destination = new / entry.name
        if entry.is_dir() and not entry.is_symlink() and destination.is_dir():
            _keep_others(entry, destination)
        elif not destination.exists():
            atomic.keep(entry, destination)


def _is_file_with(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


_OPTIONAL = {field.name: field.default for field in fields(Answers) if field.default is not MISSING}
"""What an author may leave out, with what it is then."""


def _chosen(answers: Answers) -> list[str]:
    """Return the questions that may be left out, and that were answered with something of their own."""
    return [name for name, default in _OPTIONAL.items() if getattr(answers, name) != default]
