"""A new adapter from a checkpoint: the template's package, with what the checkpoint says in the place of questions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.adopt import field
from xpl_cli.adopt.checkpoints import block, known, second, writing
from xpl_cli.adopt.checkpoints.known import ENVIRONMENTS, Known
from xpl_cli.adopt.facts import Findings, plain
from xpl_cli.basics.content import room
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io.names import CODE
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.adopt.facts import Tree
    from xpl_cli.scaffold.template import Files

_ANY: Final = "any"
"""Template for makers whose library does not run every checkpoint of theirs."""


@dataclass(frozen=True)
class Wanted:
    """What the user said.

    Attributes:
        name: of the package.
        embodiment: the robot; None to take it from the data.
        action_type: joint or ee; None to take it from the answer's parts.
        choices: cameras and grippers.
    """

    name: str
    embodiment: str | None
    action_type: str | None
    choices: block.Choices


@dataclass(frozen=True)
class Start:
    """A package that is ready to be written.

    Attributes:
        files: name to content.
        checkpoint: name that deploy.yml gives it.
        folder: where it lies.
        findings: what is known, with its sources, and what is open.
        notes: what could not be read or written, and why.
    """

    files: Files
    checkpoint: str
    folder: Path
    findings: Findings
    notes: list[str]

    def link(self, target: Path) -> None:
        """Let the checkpoint's name in a package that was written lead to its folder; a name that is taken stays.

        Raises:
            UserError: if that cannot be done.
        """
        place = target / sdk.CHECKPOINT_DIRECTORY / self.checkpoint
        try:
            place.parent.mkdir(exist_ok=True)
            if not (place.is_symlink() or place.exists()):
                place.symlink_to(self.folder.resolve(), target_is_directory=True)
        except OSError as error:
            raise UserError(f"{place} cannot be made: {error.strerror or error}") from None


def begin(paths: Sequence[Path], wanted: Wanted) -> Start:
    """Return a package that runs a checkpoint.

    Args:
        paths: the checkpoint's folder, and its data set's.
        wanted: what the user said.

    Raises:
        UserError: if the folders hold nothing that is known, or the robot is not.
    """
    found = known.read(paths, wanted.embodiment, wanted.action_type, wanted.choices)
    sections = found.sections()
    sections = {**_of_the_field(wanted.name, plain(sections.get("upstream"))), **sections}
    notes = list(found.trained.notes)
    files = _rendered(wanted.name, found)
    manifest = files[sdk.File.POLICY_YML].decode()
    written = writing.replaced(manifest, {key: writing.section(key, value) for key, value in sections.items()})
    files[sdk.File.POLICY_YML] = written.encode()
    files[sdk.File.DEPLOY_YML] = _naming(files[sdk.File.DEPLOY_YML].decode(), found.checkpoint).encode()
    files |= _code(wanted.name, found, notes)
    return Start(
        files=dict(sorted(files.items())),
        checkpoint=found.checkpoint,
        folder=found.path,
        findings=Findings.of(sections),
        notes=notes,
    )


def _of_the_field(name: str, upstream: Mapping[str, Any] | None) -> dict[str, Tree]:
    """Return what the zoo knows of the policy that a package is called like, for what no checkpoint says."""
    policy = field.called(name, None if upstream is None else upstream.get("repository"))
    known = field.facts(policy) if policy is not None else ()
    return {key: told for key, told in known if "." not in key}


def _rendered(name: str, found: Known) -> Files:
    """Return the package as the template has it."""
    from xpl_cli.scaffold import adapter, kinds

    trained = found.trained
    whole = trained.maker in ENVIRONMENTS
    chunk, ensembling = plain(trained.chunk), trained.ensembling
    answers = adapter.answers_of(
        **{
            **adapter.defaults(),
            "name": name,
            "embodiment": found.robot.name,
            sdk.Deploy.ACTION_TYPE: found.action_type,
            "chunk": chunk if isinstance(chunk, int) else 1,
            "family": trained.family.value,
            "eval_only": True,
            "kind": trained.maker if whole else kinds.DEFAULT,
            "history": found.history,
            "ensembling": ensembling.value if ensembling is not None else None,
            "cameras": list(block.smallest(trained, found.tree)),
        }
    )
    if whole:
        adapter.check(answers)
    return adapter.render(answers)


def _naming(text: str, checkpoint: str) -> str:
    """Return deploy.yml, as it was rendered, with the name of the checkpoint."""
    key = sdk.Deploy.CKPT_NAME
    return re.sub(rf"^{key}: \S+", lambda _: f"{key}: {checkpoint}", text, flags=re.MULTILINE)


def _code(name: str, found: Known, notes: list[str]) -> Files:
    """Return model.py, and reference.py if nothing that it needs is open."""
    maker = found.trained.maker
    said = {
        "name": name,
        "model_class": spec.data("package")["model_class"],
        "checkpoints": sdk.CHECKPOINT_DIRECTORY,
        "draws": found.draws,
        "history": found.history,
    }
    if maker not in ENVIRONMENTS:
        return {sdk.File.MODEL_PY: _template(_ANY, sdk.File.MODEL_PY, {**said, **_shapes(found)})}
    files = {sdk.File.MODEL_PY: _template(maker, sdk.File.MODEL_PY, said)}
    try:
        said |= second.context(found.trained, found.tree, found.robot, found.checkpoint)
    except second.UnsaidError as problem:
        notes.append(f"reference.py is not written: {problem}")
    else:
        files[CODE] = _template(maker, CODE, said)
    return files


def _shapes(found: Known) -> dict[str, Any]:
    """Return what the model that is still to be called takes and answers."""
    block_ = plain(dict(found.tree))
    names = [str(entry["input"]) for key in ("images", "state") for entry in block_.get(key, ())]
    action, chunk = block_["action"], plain(found.trained.chunk)
    pad = action.get("pad")
    text = block_.get(sdk.Obs.INSTRUCTION)
    return {
        "about": found.trained.about,
        "placeholder": spec.data("package")["placeholder"],
        "inputs": [*names, *([str(text["input"])] if text else [])],
        "chunk": chunk if isinstance(chunk, int) else 1,
        "width": pad if isinstance(pad, int) else found.trained.action.numbers.width or 1,
    }


def _template(maker: str, name: str, said: Mapping[str, Any]) -> bytes:
    """Return a file of the template of what is begun from a checkpoint.

    What the checkpoint says is text in comments, whatever it is: only what a template marks as `code` or turns into a
    literal (`tojson`) may be more.
    """
    import jinja2
    import markupsafe

    place = room("templates") / "policy" / "from" / maker
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(place),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701 - Python, not HTML
        finalize=_plain,
    )
    environment.filters["code"] = markupsafe.Markup
    return environment.get_template(f"{name}.jinja").render(said).encode()


def _plain(value: object) -> object:
    """Return a value that ends neither a comment nor a docstring of Python."""
    if not isinstance(value, str) or hasattr(value, "__html__"):
        return value
    return "".join(char if char.isprintable() and char not in '"\\' else "?" for char in value)
