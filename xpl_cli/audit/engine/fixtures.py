r"""Fixtures of rules: small overlays on the scaffold that a rule must catch (`bad/`) or accept (`good/`).

A fixture is a folder `conformance/<gate>/<slug>/{bad,good}/<case>/`. Its files replace or join those of a freshly
scaffolded adapter or, for rules about environments, environment; an optional `overlay.yml`, which is not copied, has
options:

    scaffold: {embodiment: franka_single, action_type: ee}   # its options; `false`: start from nothing; by default it
                                                             # has no model_io block, so that methods can convert
    like: ../../good/by-hand                                 # another fixture, whose files come first
    remove: [install.sh]                                     # files of the scaffold that are left out
    edit: {deploy.yml: {"eval_batch: true": "eval_batch: 1"}} # text replaced in a file of the scaffold
    append: {deploy.yml: "horizon: null"}                    # text added at the end of a file
    methods: "def reset(self): pass"                         # methods added to the model class, or to the episode's
    demonstrations: 6                                        # episodes of a scripted expert, which the package names
    message: answers for environment 3                       # text that a finding on a bad fixture contains
"""

from __future__ import annotations

import shutil
import textwrap
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.packages import package
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl.contract import Entry
    from xpl_cli.audit.rules.registry import Rule

OVERLAY = "overlay.yml"
_IGNORED = shutil.ignore_patterns(OVERLAY, "__pycache__")


@dataclass(frozen=True)
class Fixture:
    """One overlay.

    Attributes:
        folder: its folder.
        good: whether its rule must accept it.
        target: kind of package, `policy` or `env`.
        message: text that a finding on it has to contain.
    """

    folder: Path
    good: bool
    target: str = package.POLICY
    scaffold: Entry | None = field(default_factory=dict)
    remove: Sequence[str] = ()
    edit: dict[str, dict[str, str]] = field(default_factory=dict)
    append: dict[str, str] = field(default_factory=dict)
    like: str | None = None
    methods: str = ""
    demonstrations: int = 0
    message: str | None = None

    @property
    def name(self) -> str:
        """`bad/<case>` or `good/<case>`."""
        return f"{self.folder.parent.name}/{self.folder.name}"


def fixtures(rule: Rule) -> Iterator[Fixture]:
    """Yield the fixtures of a rule, bad ones first."""
    for kind in ("bad", "good"):
        for folder in sorted(path for path in (rule.folder / kind).glob("*") if path.is_dir()):
            yield _read(folder, good=kind == "good", target=rule.target)


def build(fixture: Fixture, target: Path) -> Path:
    """Write a fixture as an adapter package into the folder `target`; its name is the policy's name.

    Returns:
        the adapter's folder.
    """
    if fixture.scaffold is None:
        target.mkdir(parents=True)
    else:
        from xpl_cli.scaffold import adapter as scaffold

        scaffold_options = sorted(fixture.scaffold.items())
        options = tuple((name, tuple(value) if isinstance(value, list) else value) for name, value in scaffold_options)
        scaffold.write(_render_scaffold(fixture.target, options, target.name), target)
    if fixture.like is not None:
        shutil.copytree(fixture.folder / fixture.like, target, dirs_exist_ok=True, ignore=_IGNORED)
    for name in fixture.remove:
        (target / name).unlink()
    for name, replacements in fixture.edit.items():
        text = (target / name).read_text(encoding="utf-8")
        for old, new in replacements.items():
            if old not in text:
                message = f"{fixture.folder / OVERLAY}: {name} of the scaffold does not contain {old!r}"
                raise ValueError(message)
            text = text.replace(old, new)
        (target / name).write_text(text, encoding="utf-8")
    for name, added in fixture.append.items():
        with (target / name).open("a", encoding="utf-8") as stream:
            stream.write(f"\n{added}")
    if fixture.methods:
        # The class is the last thing in that file.
        file = sdk.File.MODEL_PY if fixture.target == package.POLICY else "episode.py"
        with (target / file).open("a", encoding="utf-8") as stream:
            stream.write("\n" + textwrap.indent(fixture.methods, "    "))
    shutil.copytree(fixture.folder, target, dirs_exist_ok=True, ignore=_IGNORED)
    if fixture.demonstrations and fixture.scaffold:
        from xpl_cli.audit.offline.demonstrations import scripted

        scripted.write(target, fixture.scaffold["embodiment"], fixture.demonstrations)
    return target


@cache
def _render_scaffold(kind: str, options: tuple[tuple[str, object], ...], name: str) -> dict[str, bytes]:
    """Return a scaffold; many fixtures share one."""
    from xpl_cli.scaffold import adapter as scaffold
    from xpl_cli.scaffold import environment
    from xpl_cli.scaffold.answers import AdapterAnswers

    if kind == package.ENV:
        answers = {**environment.env_defaults(), **dict(options), "name": name}
        return environment.render_env(environment.EnvAnswers(**answers))
    answers = {**scaffold.defaults(), "block": False, **dict(options), "name": name}
    return scaffold.render(AdapterAnswers(**answers))


def _read(folder: Path, *, good: bool, target: str) -> Fixture:
    overlay = folder / OVERLAY
    values = spec.read_yaml(overlay) if overlay.is_file() else {}
    if values.get("scaffold") is False:
        values = {**values, "scaffold": None}
    return Fixture(folder=folder, good=good, target=target, **values)
