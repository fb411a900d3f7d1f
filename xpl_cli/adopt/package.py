"""An adoption: which files an adapter gets, and writing them without changing any other."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.adopt import files, zoo_facts
from xpl_cli.adopt.checkpoints import adopted, yaml_writer
from xpl_cli.adopt.facts import Evidence, Fact, ManifestFacts, Tree, UnknownFact, certain, leaves, plain
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError
from xpl_cli.packages import manifests, package
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl.contract import Entry
    from xpl_cli.adopt.checkpoints.block import UserChoices
    from xpl_cli.standard.spec import Schema

_MANIFEST: Final = sdk.File.POLICY_YML
_SCHEMA: Final = "policy"
_VERSION: Final = "spec"
_HEAD: Final = """\
# Written by `xpl adopt` from the adapter's files, each value with its source. Values that they do not state are
# `{unknown: meaning}`; fill them in. All keys: `xpl spec show policy`.
"""


@dataclass(frozen=True)
class Adoption:
    """The files and manifest sections that an adapter gets.

    Attributes:
        folder: the adapter's.
        sections: new parts of its manifest, by top-level key, with sources.
        files: new content by name; only policy.yml may exist already, and then keys are appended.
        state: of the manifest: written, completed or unchanged.
        notes: why a checkpoint could not be read in part.
    """

    folder: Path
    sections: Mapping[str, Tree]
    files: Mapping[str, bytes]
    state: str
    notes: Sequence[str] = ()

    @functools.cached_property
    def findings(self) -> ManifestFacts:
        """All facts and unknown values."""
        return ManifestFacts.of(self.sections)

    def write(self) -> None:
        """Write the files, each atomically.

        Raises:
            UserError: a file cannot be written, or was created meanwhile.
        """
        for name, content in self.files.items():
            path = self.folder / name
            try:
                if self.state == "written" or name != _MANIFEST:
                    _create(path, content)
                else:
                    atomic.write_file(path, content, path.stat().st_mode & 0o777)
            except FileExistsError:
                raise UserError(f"{path} exists already, and is not replaced") from None
            except OSError as error:
                raise UserError(f"{path} cannot be written: {error.strerror or error}") from None


@dataclass(frozen=True)
class CheckpointSource:
    """The checkpoint of an adapter, and the user's choices.

    Attributes:
        paths: its folder, and optionally its dataset's or its framework's code.
        choices: cameras, grippers, statistics.
    """

    paths: Sequence[Path]
    choices: UserChoices


def adoption(
    path: Path, overrides: Entry, *, merge: bool, scripts: bool, trained: CheckpointSource | None = None
) -> Adoption:
    """Plan the adoption of an adapter.

    Args:
        path: its folder.
        overrides: values by dotted key of the manifest, which take precedence over those that are read.
        trained: a checkpoint that supplies further facts and the model_io block.
        merge: add to an existing manifest.
        scripts: also write the scripts that are missing.

    Raises:
        NotFoundError: there is no adapter.
        UserError: a manifest exists and `merge` is false, or an override is invalid.
    """
    folder = package.find_policy(path)
    existing = manifests.content_of(folder / _MANIFEST)
    if existing is not None and not merge:
        raise UserError(
            f"{path / _MANIFEST} exists already, and is not replaced",
            hint="--merge appends the keys that it lacks; `xpl update` brings it to the newest version",
        )
    sections, notes = _sections(folder, overrides, trained)
    contents: dict[str, bytes] = {}
    state = "written"
    if existing is None:
        content = (_HEAD + _yaml(sections)).encode()
        _check(content)
        contents[_MANIFEST] = content
    else:
        manifests.read(folder / _MANIFEST, package.POLICY)  # raises for an invalid manifest
        there = spec.parse_yaml(existing)
        sections = {key: tree for key, tree in sections.items() if key not in there}
        if sections:
            added = f"# Added by `xpl adopt`:\n{_yaml(sections)}"
            contents[_MANIFEST] = existing.rstrip(b"\n") + b"\n" + added.encode()
        state = "completed" if sections else "unchanged"
    if scripts:
        contents |= _scripts(folder, sections)
    return Adoption(folder, sections, contents, state, notes)


def _sections(
    folder: Path, overrides: Entry, trained: CheckpointSource | None
) -> tuple[dict[str, Tree], tuple[str, ...]]:
    """Return the manifest by top-level key, with unknown values, and notes on what a checkpoint does not state."""
    sections: dict[str, Tree] = {}
    for key, value in overrides.items():
        _check_key(key)
        _set_default(sections, key, certain(value, Evidence("", None, "given with --set")))
    _add_missing(sections, files.read_facts(folder))
    notes: tuple[str, ...] = ()
    if trained is not None:
        checkpoint = _checkpoint(sections, trained)
        _add_missing(sections, {key: tree for key, tree in checkpoint.sections().items() if any(leaves(tree, key))})
        notes = tuple(checkpoint.trained.notes)
    policy = zoo_facts.find_policy(folder.name)
    for key, fact in zoo_facts.facts(policy) if policy is not None else ():
        _set_default(sections, key, fact)
    for key, meaning in _required():
        _set_default(sections, key, UnknownFact(meaning))
    sections[_VERSION] = spec.VERSION
    schema = spec.schema(_SCHEMA)["properties"]
    return {key: _ordered(sections[key], schema[key]) for key in schema if key in sections}, notes


def _checkpoint(sections: Mapping[str, Tree], trained: CheckpointSource) -> adopted.AdoptedCheckpoint:
    """Read the checkpoint for the embodiment and action type found so far."""
    robots, kinds = plain(sections.get("embodiments")), plain(sections.get("action_types"))
    return adopted.read(
        trained.paths,
        str(robots[0]) if robots else None,
        str(kinds[0]) if kinds and len(kinds) == 1 else None,
        trained.choices,
    )


def _add_missing(sections: dict[str, Tree], trees: Mapping[str, Tree]) -> None:
    """Add missing values; of a map, entry by entry."""
    for key, tree in trees.items():
        if isinstance(tree, dict):
            for name, entry in tree.items():
                _set_default(sections, f"{key}.{name}", entry)
        else:
            _set_default(sections, key, tree)


def _set_default(sections: dict[str, Tree], key: str, tree: Tree) -> None:
    """Set a value at a dotted key, unless the key or a parent has one."""
    node = sections
    *above, name = key.split(".")
    for part in above:
        node = node.setdefault(part, {})
        if not isinstance(node, dict):
            return
    node.setdefault(name, tree)


def _required() -> Iterator[tuple[str, str]]:
    """Yield the required keys of a manifest with their meaning."""
    schema = spec.schema(_SCHEMA)
    for name in schema["required"]:
        entry = schema["properties"][name]
        for inner in entry.get("required", ()):
            yield f"{name}.{inner}", _meaning(inner, entry["properties"][inner])
        if "required" not in entry and name != _VERSION:
            yield name, _meaning(name, entry)


def _meaning(name: str, entry: Schema) -> str:
    options = entry.get("enum") or entry.get("items", {}).get("enum") or ()
    return str(entry.get("description", name)) + (f" ({', '.join(map(str, options))})" if options else "")


def _ordered(tree: Tree, schema: Schema) -> Tree:
    """Return a map with its keys in the order of its schema."""
    order = list(schema.get("properties", {}))
    if not isinstance(tree, dict) or not order:
        return tree
    return dict(sorted(tree.items(), key=lambda entry: order.index(entry[0]) if entry[0] in order else len(order)))


def _yaml(sections: Mapping[str, Tree]) -> str:
    return "".join(yaml_writer.section(key, tree) for key, tree in sections.items())


def _check(content: bytes) -> None:
    """Validate the manifest; missing keys are allowed.

    Raises:
        UserError: with the first invalid value.
    """
    from xpl_cli.standard.validate import validate_yaml

    _, problems = validate_yaml(content, _MANIFEST, _SCHEMA)
    for problem in problems:
        if problem.missing is None:
            location = ".".join(map(str, problem.path)) or "the manifest"
            raise UserError(f"{location}: {problem.text}", hint=f"`xpl spec show {_SCHEMA}`")


def _check_key(key: str) -> None:
    from xpl_cli.standard.problems import nearest

    schema: Any = spec.schema(_SCHEMA)
    for part in key.split("."):
        below = schema.get("properties", {})
        if isinstance(schema.get("additionalProperties"), dict):
            schema = schema["additionalProperties"]
        elif part in below:
            schema = below[part]
        else:
            near = nearest(part, below)
            hint = f"did you mean {near}?" if near else f"`xpl spec show {_SCHEMA}` lists them"
            raise UserError(f"--set {key}: the manifest has no key {part!r} there", hint=hint)
        if "anyOf" in schema or "$ref" in schema:
            return


def _scripts(folder: Path, sections: Mapping[str, Tree]) -> dict[str, bytes]:
    """Return the scripts of the template that the adapter lacks."""
    from xpl_cli.scaffold import adapter
    from xpl_cli.scaffold.answers import AdapterAnswers

    answers = adapter.defaults()
    for key, answer in (("embodiments", "embodiment"), ("action_types", sdk.Deploy.ACTION_TYPE)):
        if isinstance(fact := sections.get(key), Fact):
            answers[answer] = fact.value[0]
    answers["eval_only"] = bool(plain(sections.get("evaluation_only", True)))
    rendered = adapter.render(AdapterAnswers(name=folder.name, **answers))
    names = spec.data("package")["scripts"].keys() | {sdk.File.INSTALL_SH}
    return {name: content for name, content in rendered.items() if name in names and not (folder / name).exists()}


def _create(path: Path, content: bytes) -> None:
    """Create a file atomically; raise FileExistsError if it exists."""
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
