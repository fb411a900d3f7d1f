"""One adoption: which files an adapter gets, and how they are put there without touching any other."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.adopt import field, files
from xpl_cli.adopt.checkpoints import known, writing
from xpl_cli.adopt.facts import Evidence, Findings, Open, Told, Tree, certain, leaves, plain
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError
from xpl_cli.packages import manifests, package
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl.contract import Entry
    from xpl_cli.adopt.checkpoints.block import Choices
    from xpl_cli.standard.spec import Schema

_MANIFEST: Final = sdk.File.POLICY_YML
_SCHEMA: Final = "policy"
_VERSION: Final = "spec"
_HEAD: Final = """\
# Written by `xpl adopt`: what the adapter's files state, each value with its place. What they do not state is
# `{unknown: what it is}`; fill it in. All keys: `xpl spec show policy`.
"""


@dataclass(frozen=True)
class Adoption:
    """What an adapter gets.

    Attributes:
        folder: the adapter's.
        sections: what becomes part of its manifest, by top-level key, with sources.
        files: new contents by name; only policy.yml may be there already, and then grows.
        state: what becomes of the manifest.
        notes: what kept a checkpoint from being read.
    """

    folder: Path
    sections: Mapping[str, Tree]
    files: Mapping[str, bytes]
    state: str
    notes: Sequence[str] = ()

    @functools.cached_property
    def findings(self) -> Findings:
        """All that is known, and all that is not."""
        return Findings.of(self.sections)

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


def adoption(path: Path, given: Entry, *, merge: bool, scripts: bool, trained: Trained | None = None) -> Adoption:
    """Decide what an adapter gets.

    Args:
        path: its folder.
        given: values of the user's own, by dotted key of the manifest; they outrank what is read.
        trained: a checkpoint that says what the files do not, and fills the model_io block.
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
    sections, notes = _sections(folder, given, trained)
    contents: dict[str, bytes] = {}
    state = "written"
    if existing is None:
        content = (_HEAD + _yaml(sections)).encode()
        _check(content)
        contents[_MANIFEST] = content
    else:
        manifests.read(folder / _MANIFEST, package.POLICY)  # raises where something in it is wrong
        there = spec.parse_yaml(existing)
        sections = {key: tree for key, tree in sections.items() if key not in there}
        if sections:
            added = f"# Added by `xpl adopt`:\n{_yaml(sections)}"
            contents[_MANIFEST] = existing.rstrip(b"\n") + b"\n" + added.encode()
        state = "completed" if sections else "unchanged"
    if scripts:
        contents |= _scripts(folder, sections)
    return Adoption(folder, sections, contents, state, notes)


def _sections(folder: Path, given: Entry, trained: Trained | None) -> tuple[dict[str, Tree], tuple[str, ...]]:
    """Return the manifest by top-level key, what nobody knows of it as such, and what a checkpoint could not tell."""
    sections: dict[str, Tree] = {}
    for key, value in given.items():
        _check_key(key)
        _put(sections, key, certain(value, Evidence("", None, "given with --set")))
    _complete(sections, files.stated(folder))
    notes: tuple[str, ...] = ()
    if trained is not None:
        found = _checkpoint(sections, trained)
        _complete(sections, {key: tree for key, tree in found.sections().items() if any(leaves(tree, key))})
        notes = tuple(found.trained.notes)
    policy = field.called(folder.name)
    for key, told in field.facts(policy) if policy is not None else ():
        _put(sections, key, told)
    for key, meaning in _required():
        _put(sections, key, Open(meaning))
    sections[_VERSION] = spec.VERSION
    schema = spec.schema(_SCHEMA)["properties"]
    return {key: _ordered(sections[key], schema[key]) for key in schema if key in sections}, notes


def _checkpoint(sections: Mapping[str, Tree], trained: Trained) -> known.Known:
    """Read the checkpoint, as that of the robot and the kind of control that are known by now."""
    robots, kinds = plain(sections.get("embodiments")), plain(sections.get("action_types"))
    return known.read(
        trained.paths,
        str(robots[0]) if robots else None,
        str(kinds[0]) if kinds and len(kinds) == 1 else None,
        trained.choices,
    )


def _complete(sections: dict[str, Tree], found: Mapping[str, Tree]) -> None:
    """Add what is not there yet; of a map, entry by entry."""
    for key, tree in found.items():
        if isinstance(tree, dict):
            for name, entry in tree.items():
                _put(sections, f"{key}.{name}", entry)
        else:
            _put(sections, key, tree)


def _put(sections: dict[str, Tree], key: str, tree: Tree) -> None:
    """Put a value under a dotted key, unless that, or a part of it, has one."""
    place = sections
    *above, name = key.split(".")
    for part in above:
        place = place.setdefault(part, {})
        if not isinstance(place, dict):
            return
    place.setdefault(name, tree)


def _required() -> Iterator[tuple[str, str]]:
    """Yield the keys that a manifest must have, with what they say."""
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
    return "".join(writing.section(key, tree) for key, tree in sections.items())


def _check(content: bytes) -> None:
    """Stop where a value does not fit: one that the user gave.

    Raises:
        UserError: with the first one.
    """
    from xpl_cli.standard.validate import validate_yaml

    _, problems = validate_yaml(content, _MANIFEST, _SCHEMA)
    for problem in problems:
        if problem.missing is None:
            place = ".".join(map(str, problem.path)) or "the manifest"
            raise UserError(f"{place}: {problem.told}", hint=f"`xpl spec show {_SCHEMA}`")


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
    from xpl_cli.scaffold.answers import Answers

    chosen = adapter.defaults()
    for key, answer in (("embodiments", "embodiment"), ("action_types", sdk.Deploy.ACTION_TYPE)):
        if isinstance(told := sections.get(key), Told):
            chosen[answer] = told.value[0]
    chosen["eval_only"] = bool(plain(sections.get("evaluation_only", True)))
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
