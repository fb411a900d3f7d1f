"""A new adapter from a checkpoint: the template's package, with what the checkpoint says in the place of questions."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl.embodiment import UnknownEmbodimentError, get_embodiment
from xpl_cli.adopt.checkpoints import block, registry, second, writing
from xpl_cli.adopt.checkpoints.told import Told, Tree, certain, findings, likely, plain
from xpl_cli.adopt.facts import Evidence, Fact, Question
from xpl_cli.basics.content import room
from xpl_cli.basics.errors import UserError, one_of
from xpl_cli.native.names import CODE
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from xpl.embodiment import Embodiment
    from xpl_cli.adopt.checkpoints.trained import Trained
    from xpl_cli.scaffold.template import Files

VERSION: Final = spec.NEWEST
"""The standard of what is begun from a checkpoint: the first that has a native block."""

_NATIVE: Final = "native"
_ENVIRONMENTS: Final = {
    "lerobot": {"manager": "uv", "python": ">=3.10", "requirements": ["numpy>=1.24", "lerobot>=0.4"]}
}
"""Makers whose library runs any of their checkpoints, so that the whole adapter is written."""
_ANY: Final = "any"
"""Template for every other one."""
_SNAPSHOT: Final = re.compile(r"models--(?P<owner>[^/]+?)--(?P<name>[^/]+)/snapshots/(?P<commit>[0-9a-f]{40})$")


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
        facts: what is known, with its sources.
        questions: what is open.
        notes: what could not be read or written, and why.
    """

    files: Files
    checkpoint: str
    folder: Path
    facts: list[Fact]
    questions: list[Question]
    notes: list[str]

    @property
    def counts(self) -> dict[str, int]:
        """How many facts there are of each confidence, and how many are open."""
        counted: dict[str, int] = {}
        for fact in self.facts:
            counted[str(fact.confidence)] = counted.get(str(fact.confidence), 0) + 1
        return {**counted, "open": len(self.questions)}

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
    trained, folder = registry.read(paths, wanted.choices.statistics)
    robot, told = _robot(trained, wanted.embodiment)
    tree = block.native(trained, robot, wanted.choices)
    action_type = wanted.action_type or _action_type(plain(tree["action"]["parts"]))
    draft = _Draft(wanted.name, trained, robot, tree, action_type, folder.path)
    sections = {**_sections(draft), "embodiments": told, _NATIVE: tree}
    notes = list(trained.notes)
    files = _rendered(draft)
    manifest = files[sdk.File.POLICY_YML].decode()
    written = writing.replaced(manifest, {key: writing.section(key, value) for key, value in sections.items()})
    files[sdk.File.POLICY_YML] = written.encode()
    files[sdk.File.DEPLOY_YML] = _naming(files[sdk.File.DEPLOY_YML].decode(), draft.checkpoint).encode()
    files |= _code(draft, notes)
    found = [entry for key, value in sections.items() for entry in findings(value, key)]
    return Start(
        files=dict(sorted(files.items())),
        checkpoint=draft.checkpoint,
        folder=folder.path,
        facts=[entry for entry in found if isinstance(entry, Fact)],
        questions=[entry for entry in found if isinstance(entry, Question)],
        notes=notes,
    )


@dataclass(frozen=True)
class _Draft:
    """What a package is made of."""

    name: str
    trained: Trained
    robot: Embodiment
    tree: Mapping[str, Tree]
    action_type: str
    path: Path

    @property
    def checkpoint(self) -> str:
        """The name of the checkpoint: the hub's, or that of the run that it lies in."""
        found = _SNAPSHOT.search(self.path.absolute().as_posix())
        parts = self.path.resolve().parts
        names = [found["name"]] if found else [part for part in parts if part != "pretrained_model"]
        return re.sub(r"[^A-Za-z0-9._+-]", "_", names[-1]).lstrip("._+-")[:100] or "trained"

    @property
    def history(self) -> int:
        """Observations that the model sees."""
        length = plain(self.trained.history)["length"] if self.trained.history else 1
        return length if isinstance(length, int) else 1

    @property
    def draws(self) -> bool:
        """Whether the model draws random numbers, as far as anybody knows."""
        return bool(plain(self.tree["sampling"]) != "none")


def _robot(trained: Trained, given: str | None) -> tuple[Embodiment, Told]:
    """Return the robot and where it was read.

    Raises:
        UserError: with the robots that have as many numbers, if nothing says which it is.
    """
    known = spec.embodiments(VERSION)
    if given is not None:
        one_of("--embodiment", given, known)
        return get_embodiment(given), certain([given], Evidence("", None, "given with --embodiment"))
    if trained.robot is not None:
        try:
            robot = get_embodiment(str(trained.robot.value))
        except UnknownEmbodimentError:
            pass
        else:
            return robot, likely([robot.name], *trained.robot.evidence)
    width = trained.action.numbers.width
    fitting = [name for name in known if _joints(get_embodiment(name)) == width] or list(known)
    called = f"the files call it {trained.robot.value!r}" if trained.robot else "nothing in the files names it"
    size = f"; an action has {width} numbers" if width else ""
    raise UserError(f"which robot is it? {called}{size}", hint=f"--embodiment NAME: {', '.join(fitting)}")


def _joints(robot: Embodiment) -> int:
    return sum(arm.dof + arm.ee_dim for arm in robot.arms)


def _action_type(parts: Any) -> str:
    """Return the kind of control whose words an answer's parts are: poses are ee, everything else joint."""
    joint, ee = sdk.ACTION_TYPES
    kinds = {kind for part in parts for kind in part} if isinstance(parts, list) else set()
    return str(ee if kinds & {"position", "rotation"} else joint)


def _sections(draft: _Draft) -> dict[str, Tree]:
    """Return the top-level keys of policy.yml that a checkpoint fills."""
    trained, sampling = draft.trained, draft.trained.sampling
    seeded: Tree = True
    if isinstance(sampling, Told):
        seeded = Told(sampling.value != "free", sampling.confidence, sampling.evidence)
    result: dict[str, Tree] = {
        "summary": likely(trained.about, *trained.family.evidence),
        "family": trained.family,
        "temporal": block.temporal(trained),
        "inputs": block.inputs(draft.tree, draft.robot),
        "cameras": block.smallest(trained, draft.tree),
        "action_types": [draft.action_type],
        "deterministic": seeded,
        "evaluation_only": True,
    }
    if trained.maker in _ENVIRONMENTS:
        result["environment"] = dict(_ENVIRONMENTS[trained.maker])
    if trained.rate is not None:
        result["control_frequency"] = trained.rate
    if trained.upstream is not None:
        result["upstream"] = trained.upstream
    if (hub := _SNAPSHOT.search(draft.path.absolute().as_posix())) is not None:
        source = {"source": f"hf://{hub['owner']}/{hub['name']}", "revision": hub["commit"]}
        where = Evidence("", None, "the folder in the hub's cache")
        result["checkpoints"] = [certain({"name": draft.checkpoint, **source}, where)]
    return result


def _rendered(draft: _Draft) -> Files:
    """Return the package as the template has it."""
    from xpl_cli.scaffold import adapter, kinds

    template = adapter.policy_template(VERSION)
    trained = draft.trained
    whole = trained.maker in _ENVIRONMENTS
    chunk, ensembling = plain(trained.chunk), trained.ensembling
    answers = adapter.answers_of(
        **{
            **adapter.defaults(template),
            "name": draft.name,
            "embodiment": draft.robot.name,
            sdk.Deploy.ACTION_TYPE: draft.action_type,
            "chunk": chunk if isinstance(chunk, int) else 1,
            "family": trained.family.value,
            "eval_only": True,
            "kind": trained.maker if whole else kinds.DEFAULT,
            "history": draft.history,
            "ensembling": ensembling.value if ensembling is not None else None,
            "cameras": list(block.smallest(trained, draft.tree)),
        }
    )
    if whole:
        adapter.check(answers, template)
    return adapter.render(answers, template)


def _naming(text: str, checkpoint: str) -> str:
    """Return deploy.yml with the name of the checkpoint."""
    from xpl_cli.basics.yaml.edit import Document

    document = Document(text)
    document.set(sdk.Deploy.CKPT_NAME, checkpoint)
    return document.result()


def _code(draft: _Draft, notes: list[str]) -> Files:
    """Return model.py, and native.py if nothing that it needs is open."""
    maker = draft.trained.maker
    said = {
        "name": draft.name,
        "model_class": spec.data("package", VERSION)["model_class"],
        "checkpoints": sdk.CHECKPOINT_DIRECTORY,
        "draws": draft.draws,
        "history": draft.history,
    }
    if maker not in _ENVIRONMENTS:
        return {sdk.File.MODEL_PY: _template(_ANY, sdk.File.MODEL_PY, {**said, **_shapes(draft)})}
    files = {sdk.File.MODEL_PY: _template(maker, sdk.File.MODEL_PY, said)}
    try:
        said |= second.context(draft.trained, draft.tree, draft.robot, draft.checkpoint)
    except second.UnsaidError as problem:
        notes.append(f"native.py is not written: {problem}")
    else:
        files[CODE] = _template(maker, CODE, said)
    return files


def _shapes(draft: _Draft) -> dict[str, Any]:
    """Return what the model that is still to be called takes and answers."""
    block_ = plain(dict(draft.tree))
    names = [str(entry["input"]) for key in ("images", "state") for entry in block_.get(key, ())]
    action, chunk = block_["action"], plain(draft.trained.chunk)
    pad = action.get("pad")
    text = block_.get(sdk.Obs.INSTRUCTION)
    return {
        "about": draft.trained.about,
        "placeholder": spec.data("package", VERSION)["placeholder"],
        "inputs": [*names, *([str(text["input"])] if text else [])],
        "chunk": chunk if isinstance(chunk, int) else 1,
        "width": pad if isinstance(pad, int) else draft.trained.action.numbers.width or 1,
    }


def _template(maker: str, name: str, said: Mapping[str, Any]) -> bytes:
    """Return a file of the template of what is begun from a checkpoint."""
    import jinja2

    place = room("templates") / "policy" / VERSION / "from" / maker
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(place),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701 - Python, not HTML
    )
    return environment.get_template(f"{name}.jinja").render(said).encode()
