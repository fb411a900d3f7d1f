"""A new adapter from a checkpoint: the template's package, filled in with the checkpoint's facts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.adopt import zoo_facts
from xpl_cli.adopt.checkpoints import adopted, block, reference_code, yaml_writer
from xpl_cli.adopt.facts import ManifestFacts, plain
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io.names import CODE
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.adopt.checkpoints.adopted import AdoptedCheckpoint
    from xpl_cli.adopt.facts import Tree
    from xpl_cli.scaffold.template import Files

_ANY: Final = "any"
"""Template for frameworks whose library does not run every checkpoint of theirs."""


@dataclass(frozen=True)
class StartOptions:
    """The user's options.

    Attributes:
        name: of the package.
        embodiment: the robot; None to take it from the dataset.
        action_type: joint or ee; None to take it from the parts of the action.
        choices: cameras and grippers.
    """

    name: str
    embodiment: str | None
    action_type: str | None
    choices: block.UserChoices


@dataclass(frozen=True)
class NewPackage:
    """A package ready to be written.

    Attributes:
        files: content by name.
        checkpoint: its name in deploy.yml.
        folder: of the checkpoint.
        findings: facts and unknown values.
        notes: what could not be read or written, and why.
    """

    files: Files
    checkpoint: str
    folder: Path
    findings: ManifestFacts
    notes: list[str]

    def link(self, target: Path) -> None:
        """Link the checkpoint's name in a written package to its folder; keep an existing entry.

        Raises:
            UserError: the link cannot be created.
        """
        link = target / sdk.CHECKPOINT_DIRECTORY / self.checkpoint
        try:
            link.parent.mkdir(exist_ok=True)
            if not (link.is_symlink() or link.exists()):
                link.symlink_to(self.folder.resolve(), target_is_directory=True)
        except OSError as error:
            raise UserError(f"{link} cannot be created: {error.strerror or error}") from None


def new_package(paths: Sequence[Path], options: StartOptions) -> NewPackage:
    """Plan a package that runs a checkpoint.

    Args:
        paths: the checkpoint's folder, and optionally its dataset's.
        options: of the user.

    Raises:
        UserError: no framework recognises the folders, or the robot is unknown.
    """
    adopted_checkpoint = adopted.read(paths, options.embodiment, options.action_type, options.choices)
    sections = adopted_checkpoint.sections()
    sections = {**_zoo_sections(options.name, plain(sections.get("upstream"))), **sections}
    notes = list(adopted_checkpoint.trained.notes)
    files = _render(options.name, adopted_checkpoint)
    manifest = files[sdk.File.POLICY_YML].decode()
    written = yaml_writer.replace_sections(
        manifest, {key: yaml_writer.section(key, value) for key, value in sections.items()}
    )
    files[sdk.File.POLICY_YML] = written.encode()
    files[sdk.File.DEPLOY_YML] = _set_checkpoint_name(
        files[sdk.File.DEPLOY_YML].decode(), adopted_checkpoint.checkpoint
    ).encode()
    files |= _code(options.name, adopted_checkpoint, notes)
    return NewPackage(
        files=dict(sorted(files.items())),
        checkpoint=adopted_checkpoint.checkpoint,
        folder=adopted_checkpoint.path,
        findings=ManifestFacts.of(sections),
        notes=notes,
    )


def _zoo_sections(name: str, upstream: Mapping[str, Any] | None) -> dict[str, Tree]:
    """Return the zoo's facts about the policy of the package's name, for keys that no checkpoint has."""
    policy = zoo_facts.find_policy(name, None if upstream is None else upstream.get("repository"))
    facts = zoo_facts.facts(policy) if policy is not None else ()
    return {key: fact for key, fact in facts if "." not in key}


def _render(name: str, checkpoint: AdoptedCheckpoint) -> Files:
    """Render the package from the template."""
    from xpl_cli.scaffold import adapter, kinds

    trained = checkpoint.trained
    is_runnable = bool(trained.requirements)
    chunk, ensembling = plain(trained.chunk), trained.ensembling
    answers = adapter.answers_of(
        **{
            **adapter.defaults(),
            "name": name,
            "embodiment": checkpoint.robot.name,
            sdk.Deploy.ACTION_TYPE: checkpoint.action_type,
            "chunk": chunk if isinstance(chunk, int) else 1,
            "family": trained.family.value,
            "eval_only": True,
            "kind": trained.framework if is_runnable else kinds.DEFAULT,
            "history": checkpoint.history,
            "ensembling": ensembling.value if ensembling is not None else None,
            "cameras": list(block.camera_sizes(trained, checkpoint.tree)),
        }
    )
    if is_runnable:
        adapter.check(answers)
    return adapter.render(answers)


def _set_checkpoint_name(text: str, checkpoint: str) -> str:
    """Return the rendered deploy.yml with the name of the checkpoint."""
    key = sdk.Deploy.CKPT_NAME
    return re.sub(rf"^{key}: \S+", lambda _: f"{key}: {checkpoint}", text, flags=re.MULTILINE)


def _code(name: str, checkpoint: AdoptedCheckpoint, notes: list[str]) -> Files:
    """Return model.py, and reference.py if all values that it needs are known."""
    framework = checkpoint.trained.framework
    variables = {
        "name": name,
        "model_class": spec.data("package")["model_class"],
        "checkpoints": sdk.CHECKPOINT_DIRECTORY,
        "draws": checkpoint.draws,
        "history": checkpoint.history,
    }
    if not checkpoint.trained.requirements:
        return {sdk.File.MODEL_PY: _template(_ANY, sdk.File.MODEL_PY, {**variables, **_model_interface(checkpoint)})}
    files = {sdk.File.MODEL_PY: _template(framework, sdk.File.MODEL_PY, variables)}
    try:
        variables |= reference_code.context(
            checkpoint.trained, checkpoint.tree, checkpoint.robot, checkpoint.checkpoint
        )
    except reference_code.UnknownFactError as problem:
        notes.append(f"reference.py is not written: {problem}")
    else:
        files[CODE] = _template(framework, CODE, variables)
    return files


def _model_interface(checkpoint: AdoptedCheckpoint) -> dict[str, Any]:
    """Return inputs and outputs of the model that the author still has to call."""
    block_ = plain(dict(checkpoint.tree))
    names = [str(entry["input"]) for key in ("images", "state") for entry in block_.get(key, ())]
    action, chunk = block_["action"], plain(checkpoint.trained.chunk)
    pad = action.get("pad")
    text = block_.get(sdk.Obs.INSTRUCTION)
    return {
        "about": checkpoint.trained.about,
        "placeholder": spec.data("package")["placeholder"],
        "inputs": [*names, *([str(text["input"])] if text else [])],
        "chunk": chunk if isinstance(chunk, int) else 1,
        "width": pad if isinstance(pad, int) else checkpoint.trained.action.numbers.width or 1,
    }


def _template(framework: str, name: str, variables: Mapping[str, Any]) -> bytes:
    """Render a file of the templates for checkpoints.

    Values of the checkpoint are untrusted: they are escaped for comments, unless the template marks them as `code` or
    turns them into a literal (`tojson`).
    """
    import jinja2
    import markupsafe

    folder = content_folder("templates") / "policy" / "from" / framework
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701 - Python, not HTML
        finalize=_comment_safe,
    )
    environment.filters["code"] = markupsafe.Markup
    return environment.get_template(f"{name}.jinja").render(variables).encode()


def _comment_safe(value: object) -> object:
    """Return a value that cannot end a Python comment or docstring."""
    if not isinstance(value, str) or hasattr(value, "__html__"):
        return value
    return "".join(char if char.isprintable() and char not in '"\\' else "?" for char in value)
