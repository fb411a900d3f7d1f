"""An adapter package: its manifests, and the configuration of a run."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import variants
from xpl.manifest import Manifest
from xpl_cli.basics import content
from xpl_cli.basics.errors import NotFoundError, UserError
from xpl_cli.packages import documented, manifests, robots
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Config, Entry

MARKS = (sdk.File.MODEL_PY, sdk.File.DEPLOY_YML, sdk.File.POLICY_YML)
"""A folder with any of these files is an adapter."""

POLICY, ENV = "policy", "env"
MANIFESTS = {POLICY: sdk.File.POLICY_YML, ENV: "env.yml"}
"""The manifest of each kind of package."""
_ROOMS = {"policy": POLICY, "envs": ENV}
_DEPLOY = "deploy"


@dataclass(frozen=True)
class Package:
    """A policy adapter: its folder, deploy.yml and policy.yml."""

    path: Path
    deploy: Config
    manifest: Manifest = field(default_factory=Manifest)

    @property
    def name(self) -> str:
        """The folder's name, which is the policy's name."""
        return self.path.name

    def without(self, keys: Sequence[str]) -> Package:
        """Return the package without some keys of deploy.yml."""
        return replace(self, deploy={key: value for key, value in self.deploy.items() if key not in keys})

    def config(self, overrides: Config | None = None) -> dict[str, Any]:
        """Return the configuration of a run: the spec's defaults, deploy.yml, then overrides.

        Remaining null keys come from the manifest: the first embodiment and the first action type. For an adapter
        without a manifest, they come from its documents.
        """
        settings = {**self.deploy, **(overrides or {})}
        if not self.manifest and settings.get(sdk.Deploy.ENV_CFG_TYPE) is None:
            documented_values = documented.documented_arguments(self.path)
            settings |= {key: value for key, value in documented_values.items() if settings.get(key) is None}
        config = {**sdk.DEPLOY_DEFAULTS, **settings}
        fallbacks = {
            sdk.Deploy.POLICY_NAME: self.name,
            sdk.Deploy.ENV_CFG_TYPE: next(iter(self.manifest.embodiments), None),
            sdk.Deploy.ACTION_TYPE: next(iter(self.manifest.action_types), None),
        }
        for key, fallback in fallbacks.items():
            if settings.get(key) is None:
                config[key] = fallback if fallback is not None else config.get(key)
        if config[sdk.Deploy.SEED] is None:
            config[sdk.Deploy.SEED] = sdk.DEPLOY_DEFAULTS[sdk.Deploy.SEED]
        return config

    def require_declared(self, config: Config) -> None:
        """Raise if a configuration is not among those that policy.yml declares.

        Args:
            config: the configuration of a run.

        Raises:
            UserError: if policy.yml declares other robots or action types.
        """
        from xpl.embodiment import why_undeclared  # which needs numpy

        requested = (str(config[key]) for key in (sdk.Deploy.ENV_CFG_TYPE, sdk.Deploy.ACTION_TYPE))
        if (refused := why_undeclared(self.manifest, *requested)) is not None:
            hint = "select one of them with --set, or declare it in policy.yml if the model supports it"
            raise UserError(f"{self.name}: {refused}", hint=hint)


def find_policy(path: Path | str) -> Path:
    """Return the folder of an adapter by its path, or by its name below `policy/` of the working directory or of xpl.

    Registers the robots that it and its project describe.

    Raises:
        NotFoundError: if there is no such folder with an adapter in it.
        UserError: if a file describes no valid robot, or one whose name is taken.
    """
    requested = Path(path)
    candidates = [requested, Path("policy") / requested, content.content_folder("policy") / requested]
    for candidate in candidates:
        if candidate.is_dir() and any((candidate / name).is_file() for name in MARKS):
            folder = candidate.resolve()
            robots.register_robots(folder)
            return folder
    if requested.is_dir():
        raise NotFoundError(
            f"{requested} is a folder without an adapter: expected model.py, deploy.yml or policy.yml in it"
        )
    hint = f"`xpl new-policy {requested.name}` makes one"
    if any(
        (content.content_folder(room) / requested.name / MANIFESTS[kind]).is_file() for room, kind in _ROOMS.items()
    ):
        hint = f"one of that name comes with xpl, and is called {requested.name} alone"
    raise NotFoundError(f"no adapter at {requested}", hint=hint)


def load(path: Path | str, overrides: Config | None = None) -> Package:
    """Read an adapter's deploy.yml and policy.yml, with the variant of the run applied.

    Args:
        path: its folder or name.
        overrides: keys of deploy.yml; `variant` selects a variant.

    Raises:
        NotFoundError: if there is no adapter at `path`.
        ManifestError: if one of them has problems.
        UserError: if there is no such variant.
    """
    folder = find_policy(path)
    manifest: Entry = manifests.read(folder / sdk.File.POLICY_YML, POLICY)
    deploy: Entry = manifests.read(folder / sdk.File.DEPLOY_YML, _DEPLOY)
    try:
        manifest, patch = variants.apply_variant(manifest, {**deploy, **(overrides or {})}.get(sdk.Deploy.VARIANT))
    except variants.VariantError as error:
        raise UserError(f"{folder.name}: {error}") from None
    return Package(folder, variants.merge_patch(deploy, patch), Manifest.parse(manifest))


def parse_overrides(settings: Sequence[str]) -> dict[str, Any]:
    """Parse `KEY=VALUE` settings; a value is YAML, so `false` is a flag and `3` a number.

    Raises:
        UserError: if a setting has no `=`, or its value is no YAML, or not valid in deploy.yml.
    """
    import yaml

    from xpl_cli.standard.validate import validate

    result: dict[str, Any] = {}
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not separator or not key:
            raise UserError(f"--set takes KEY=VALUE, got {setting!r}")
        try:
            result[key] = spec.parse_yaml(value)
        except yaml.YAMLError as error:
            raise UserError(f"--set {key}: {value!r} is not a YAML value ({type(error).__name__})") from None
    wrong = next((problem for problem in validate(result, _DEPLOY) if problem.missing is None), None)
    if wrong is not None:
        raise UserError(f"--set {wrong}", hint=f"`xpl spec show {_DEPLOY}` lists every key")
    return result
