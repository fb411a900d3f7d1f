"""Rendering of adapter packages and writing them atomically.

The template takes all facts from the spec. A render is a map from file names to contents: `xpl new-policy` writes it,
and later updates merge it.
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
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.standard import schemas, spec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from xpl_cli.scaffold.template import Files

_REFERENCE = spec.data("package")["files"]["reference"]
"""The file that is written only on request."""

State = Literal["written", "unchanged", "replaced"]

# With the adapter's parent folder on `sys.path`, as launchers have it, an adapter would shadow these modules.
_SHADOWED = frozenset((*sys.stdlib_module_names, "numpy", "xpl", "xpl_cli"))


@dataclass(frozen=True)
class Placeholder:
    """A placeholder in a rendered file, which the author has to fill in."""

    file: str
    line: int
    text: str


def defaults() -> dict[str, Any]:
    """Return the default answers: the spec's, else the template's."""
    questions = templates.questions(POLICY)
    temporal = spec.schema("policy")["properties"]["temporal"]["properties"]
    settings = spec.schema("deploy")["properties"] | temporal
    of_spec = {key: settings[key]["default"] for key in questions if "default" in settings.get(key, ())}
    return of_spec | {key: entry["default"] for key, entry in questions.items() if "default" in entry}


def choices() -> dict[str, list[str]]:
    """Return the allowed answers of the questions for which the spec lists them."""
    return {
        "embodiment": list(robots.entries()),
        sdk.Deploy.ACTION_TYPE: list(spec.data("conventions")["action"]["types"]),
        "family": list(spec.schema("policy")["properties"]["family"]["enum"]),
    }


def check(answers: AdapterAnswers) -> None:
    """Check all answers.

    Raises:
        UserError: with every invalid answer, and the nearest valid ones.
    """
    errors: list[UserError] = []
    for refuse in _checks(answers):
        try:
            refuse()
        except UserError as error:
            errors.append(error)
    if len(errors) > 1:
        messages = [f"{error} ({error.hint})" if error.hint else str(error) for error in errors]
        raise UserError("; ".join(messages), hint="fix each of them and run the command again")
    if errors:
        raise errors[0]


def _checks(answers: AdapterAnswers) -> Iterator[Callable[[], None]]:
    """Yield the checks of the answers."""
    yield partial(check_name, answers.name)
    for question, allowed in choices().items():
        yield partial(check_choice, _option(question), getattr(answers, question), allowed)
    yield partial(kinds.check_kind, answers.kind)
    if answers.kind in kinds.kinds():
        for question in _non_default_options(answers):
            yield partial(kinds.check_fits, answers.kind, question)
    for question in ("chunk", "history"):
        yield partial(_check_count, question, getattr(answers, question))
    yield partial(kinds.check_ensembling, answers.ensembling, answers.chunk)
    if answers.embodiment in robots.entries():
        yield partial(kinds.check_cameras, answers.cameras, answers.embodiment)
    yield partial(kinds.check_python, answers.python)


def _check_count(question: str, value: int) -> None:
    if value < 1:
        raise UserError(f"{_option(question)} must be at least 1, got {value}")


def _option(question: str) -> str:
    return f"--{question.replace('_', '-')}"


def check_choice(option: str, answer: str, allowed: Sequence[str]) -> None:
    """Check that an answer is one of the allowed ones.

    Raises:
        UnknownNameError: with the nearest one.
    """
    one_of(option, answer, allowed)


def check_name(name: str) -> None:
    """Check that a package of this name can be imported and shadows no other module.

    Raises:
        UserError: with a valid name.
    """
    identifier = spec.schema("common")["$defs"]["identifier"]["pattern"]
    if re.fullmatch(identifier, name) is None:
        why = "a name starts with a letter or underscore, followed by letters, digits and underscores (ASCII)"
    elif keyword.iskeyword(name):
        why = "it is a keyword of Python"
    elif name in _SHADOWED:
        why = f"it would shadow the Python module {name}"
    elif name.startswith("__"):
        why = "names with two leading underscores are Python's own"
    elif len(name) > 100:
        why = f"it has {len(name)} characters, and 100 are the most"
    else:
        return
    raise UserError(f"{name!r} cannot name a package: {why}", hint=f"a valid name: {suggest_name(name)}")


def suggest_name(name: str) -> str:
    """Return the nearest name that `check_name` accepts."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    candidate = re.sub(r"\W+", "_", ascii_name).strip("_")[:90] or "my_policy"
    if candidate[0].isdigit():
        candidate = f"policy_{candidate}"
    return f"{candidate}_policy" if keyword.iskeyword(candidate) or candidate in _SHADOWED else candidate


def render(answers: AdapterAnswers) -> Files:
    """Render the adapter template; deterministic in the answers.

    Returns:
        content by file name, relative to the package; sorted.
    """
    training = spec.data("package")["files"]["training"]
    variables = context.context(answers)
    leave_out = [*(training if variables["evaluation_only"] else ()), *([] if answers.reference else [_REFERENCE])]
    files = templates.render(POLICY, variables, leave_out, answers.kind)
    return with_lock(files, POLICY, asdict(answers))


def with_lock(files: Files, template: str, answers: Mapping[str, Any]) -> Files:
    """Add the files below `.xpl/` to a render: schemas for editors, the lockfile, and the rendered files."""
    roles = templates.roles(template)
    for_editors = {schemas.path(name): schemas.render(name) for name in roles["schemas"]}
    contents = {**files, **for_editors}
    generated = [name for name in contents if name in roles["generated"] or name in for_editors]
    package_lock = lock.Lock(template, answers, {name: lock.digest(contents[name]) for name in generated})
    contents |= {lock.PATH: package_lock.text().encode(), lock.RENDERED: lock.rendered_text(files)}
    return dict(sorted(contents.items()))


def answers_of(**values: Any) -> AdapterAnswers:
    """Return answers from the values of a lockfile or of the command line."""
    return AdapterAnswers(**{**values, "cameras": tuple(values.get("cameras") or ())})


def recorded_answers(package_lock: lock.Lock) -> AdapterAnswers:
    """Return the recorded answers of a scaffolded adapter; newer questions have their defaults.

    Raises:
        UserError: the recorded answers are invalid.
    """
    with answer_errors("a package"):
        answers = answers_of(**merged_answers(package_lock, AdapterAnswers, defaults()))
        check(answers)
    return answers


def merged_answers(package_lock: lock.Lock, form: type[Any], usual: Mapping[str, Any]) -> dict[str, Any]:
    """Return the lockfile's values for the fields of an answers class, with defaults for the others."""
    names = {field.name for field in fields(form)}
    return {**usual, **{key: value for key, value in package_lock.answers.items() if key in names}}


@contextmanager
def answer_errors(kind: str) -> Iterator[None]:
    """Turn type errors of recorded answers into `UserError`.

    Raises:
        UserError: the answers are not those of this kind of package.
    """
    try:
        yield
    except (TypeError, AttributeError) as error:
        raise UserError(f"the recorded answers are not those of {kind}: {error}") from None


def needs_environment(answers: AdapterAnswers) -> bool:
    """Tell whether the package runs in a Python of its own."""
    return bool(kinds.kinds()[answers.kind].python(answers.python)["manager"] != kinds.TOOLS_OWN)


def placeholders(files: Mapping[str, bytes]) -> list[Placeholder]:
    """Return every placeholder, in the order of files and lines."""
    marker = re.compile(rf"{re.escape(spec.data('package')['placeholder'])}:\s*(.+)")
    return [
        Placeholder(name, number, match.group(1).rstrip(" |"))
        for name, content in files.items()
        if not name.startswith(f"{schemas.FOLDER}/")
        for number, line in enumerate(content.decode().splitlines(), start=1)
        if (match := marker.search(line))
    ]


def differences(files: Mapping[str, bytes], target: Path) -> list[str]:
    """Return the names of the rendered files that are missing in `target` or differ."""
    return [name for name, content in files.items() if not _is_file_with(target / name, content)]


def write(files: Mapping[str, bytes], target: Path, *, overwrite: bool = False) -> State:
    """Write a render atomically: the whole package or nothing.

    Args:
        files: the render.
        target: folder of the package.
        overwrite: replace files that differ. The author's other files are kept.

    Raises:
        UserError: `target` has other content and `overwrite` is false, or it cannot be written.
    """
    target = target.resolve()
    exists = target.exists()
    if exists and not target.is_dir():
        raise UserError(f"{target} is a file: expected a folder, or nothing, where the package goes")
    changed = differences(files, target)
    if not changed:
        return "unchanged"
    is_occupied = exists and any(target.iterdir())
    if is_occupied and not overwrite:
        raise UserError(
            f"{target} exists and differs from the template in {len(changed)} files: {', '.join(changed)}",
            hint="choose another name, or replace these files with --overwrite (files of your own are kept)",
        )
    try:
        with atomic.replaced_folder(target) as staging:
            for name, content in files.items():
                path = staging / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
                path.chmod(0o755 if path.suffix == ".sh" else 0o644)
            if is_occupied:
                _keep_others(target, staging)
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        raise UserError(f"{target} cannot be written: {error.strerror or error}{where}") from None
    return "replaced" if is_occupied else "written"


def _keep_others(old: Path, new: Path) -> None:
    """Copy the author's own files from the old folder to the new one."""
    for entry in old.iterdir():
        destination = new / entry.name
        if entry.is_dir() and not entry.is_symlink() and destination.is_dir():
            _keep_others(entry, destination)
        elif not destination.exists():
            atomic.keep(entry, destination)


def _is_file_with(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


_OPTIONAL = {field.name: field.default for field in fields(AdapterAnswers) if field.default is not MISSING}
"""Optional answers, with their defaults."""


def _non_default_options(answers: AdapterAnswers) -> list[str]:
    """Return the optional questions with an answer that is not the default."""
    return [name for name, default in _OPTIONAL.items() if getattr(answers, name) != default]
