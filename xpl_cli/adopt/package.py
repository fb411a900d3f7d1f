"""One adoption: which files an adapter gets, and how they are put there without touching any other."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.adopt import field, infer, manifest
from xpl_cli.adopt.checkpoints import known
from xpl_cli.adopt.checkpoints.told import findings
from xpl_cli.adopt.facts import Fact, Question
from xpl_cli.audit.static.source import Source
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError
from xpl_cli.packages import manifests, package
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from xpl_cli.adopt.checkpoints.block import Choices

_MANIFEST = sdk.File.POLICY_YML


@dataclass(frozen=True)
class Adoption:
    """What an adapter gets.

    Attributes:
        folder: the adapter's.
        draft: what was read.
        files: new contents by name; only policy.yml may be there already, and then grows.
        state: what becomes of the manifest.
    """

    folder: Path
    draft: infer.Draft
    files: dict[str, bytes]
    state: str

    @property
    def counts(self) -> dict[str, int]:
        """How many facts there are of each confidence, and how many open questions."""
        found = Counter(str(entry.confidence) for entry in self.entries if isinstance(entry, Fact))
        return {**found, "open": sum(not isinstance(entry, Fact) for entry in self.entries)}

    @property
    def entries(self) -> list[Fact | Question]:
        """All facts and open questions, those of the native block last."""
        native = findings(self.draft.native, known.NATIVE) if self.draft.native is not None else ()
        return [*self.draft.facts.values(), *self.draft.questions.values(), *native]

    def write(self) -> None:
        """Put the files there, each in one step.

        Raises:
            UserError: if one cannot be written, or has come there meanwhile.
        """
        for name, content in self.files.items():
            path = self.folder / name
            try:
                if self.state == "written" or name != _MANIFEST:
                    _create(path, content)
                else:
                    atomic.write_file(path, content, path.stat().st_mode & 0o777)
            except FileExistsError:
                raise UserError(f"{path} is there already, and is not replaced") from None
            except OSError as error:
                raise UserError(f"{path} cannot be written: {error.strerror or error}") from None


@dataclass(frozen=True)
class Trained:
    """A checkpoint that an adapter runs, and what the user said of it.

    Attributes:
        paths: its folder, and its data set's or its maker's code where the user has that.
        choices: cameras, grippers, statistics.
    """

    paths: Sequence[Path]
    choices: Choices


def adoption(
    path: Path, given: Mapping[str, Any], *, merge: bool, scripts: bool, trained: Trained | None = None
) -> Adoption:
    """Decide what an adapter gets.

    Args:
        path: its folder.
        given: values of the user's own, by dotted key of the manifest.
        trained: a checkpoint that answers what the code leaves open, and fills the native block.
        merge: add to a manifest that is there.
        scripts: also make the scripts that are missing.

    Raises:
        NotFoundError: if there is no adapter.
        UserError: if it has a manifest already and `merge` is not asked for, or a given value does not fit.
    """
    folder = package.find_policy(path)
    existing = manifests.content_of(folder / _MANIFEST)
    if existing is not None and not merge:
        raise UserError(
            f"{path / _MANIFEST} is there already, and is not replaced",
            hint="--merge appends the keys that it lacks; `xpl update` brings it to the newest version",
        )
    draft = infer.draft(Source(folder), given)
    if trained is not None:
        draft = _answered(draft, trained)
    draft = _of_the_field(draft, folder.name)
    files: dict[str, bytes] = {}
    if existing is None:
        content = manifest.text(draft)
        manifest.check(content, draft)
        files[_MANIFEST] = content.encode()
        state = "written"
    else:
        values = manifests.read(folder / _MANIFEST, package.POLICY)
        added, names = manifest.addition(draft, values)
        draft = _only(draft, names)
        if added:
            files[_MANIFEST] = existing.rstrip(b"\n") + b"\n" + added.encode()
        state = "completed" if added else "unchanged"
    if scripts:
        files |= _scripts(folder, draft)
    return Adoption(folder, draft, files, state)


def _answered(draft: infer.Draft, trained: Trained) -> infer.Draft:
    """Return a draft whose open questions are answered by a checkpoint, with its native block.

    What the code says outranks the checkpoint: an adapter may hand on fewer steps than a model answers.
    """
    robots = draft.facts.get("embodiments")
    kinds = draft.facts.get("action_types")
    found = known.read(
        trained.paths,
        str(robots.value[0]) if robots is not None and robots.value else None,
        str(kinds.value[0]) if kinds is not None and len(kinds.value) == 1 else None,
        trained.choices,
    )
    sections = found.sections()
    native = sections.pop(known.NATIVE)
    told = {
        entry.key: entry
        for key, value in sections.items()
        for entry in findings(value, key)
        if isinstance(entry, Fact) and entry.key in draft.questions
    }
    questions = {key: question for key, question in draft.questions.items() if key not in told}
    notes = (*draft.notes, *found.trained.notes)
    return infer.Draft({**draft.facts, **told}, questions, notes, native)


def _of_the_field(draft: infer.Draft, name: str) -> infer.Draft:
    """Return a draft whose open questions are answered by what the zoo knows of the policy, if it is there."""
    known, questions = dict(draft.facts), dict(draft.questions)
    code = known.get("upstream")
    policy = field.called(name, code.value["repository"] if code is not None and code.value else None)
    for fact in field.facts(policy) if policy is not None else ():
        if questions.pop(fact.key, None) is not None:
            known[fact.key] = fact
        elif fact.key in known and isinstance(known[fact.key].value, dict):
            known[fact.key] = field.completed(known[fact.key], fact)
    if code is not None and code.value:
        known["upstream"] = field.licensed(known["upstream"])
    return infer.Draft(known, questions, draft.notes, draft.native)


def _only(draft: infer.Draft, names: list[str]) -> infer.Draft:
    """Return the part of a draft that is about some keys."""
    facts = {key: fact for key, fact in draft.facts.items() if key.partition(".")[0] in names}
    questions = {key: question for key, question in draft.questions.items() if key.partition(".")[0] in names}
    return infer.Draft(facts, questions, draft.notes, draft.native if known.NATIVE in names else None)


def _scripts(folder: Path, draft: infer.Draft) -> dict[str, bytes]:
    """Return the scripts of the template that the adapter lacks."""
    from xpl_cli.scaffold import adapter
    from xpl_cli.scaffold.answers import Answers

    chosen = adapter.defaults()
    for key, answer in (("embodiments", "embodiment"), ("action_types", sdk.Deploy.ACTION_TYPE)):
        if key in draft.facts:
            chosen[answer] = draft.facts[key].value[0]
    chosen["eval_only"] = "evaluation_only" not in draft.facts or bool(draft.facts["evaluation_only"].value)
    rendered = adapter.render(Answers(name=folder.name, **chosen))
    wanted = spec.data("package")["scripts"].keys() | {sdk.File.INSTALL_SH}
    return {name: content for name, content in rendered.items() if name in wanted and not (folder / name).exists()}


def _create(path: Path, content: bytes) -> None:
    """Write a new file: whole or not at all, and never over one that is there."""
    import os
    import tempfile
    from pathlib import Path as LocalPath

    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    partial = LocalPath(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        partial.chmod(0o755 if path.suffix == ".sh" else 0o644)
        os.link(partial, path)
    finally:
        partial.unlink(missing_ok=True)
