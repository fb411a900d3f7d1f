"""An import finder that provides replacements of the ecosystem's modules where the real ones are not installed."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
from collections.abc import Collection, Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType

from xpl.ecosystem import checkout

_OFFERED = Path(__file__).parent / "offered"
_CLIENTS = "clients"
_MODULES: Mapping[str, str] = {
    f"{checkout.PACKAGE}.model_template": "model_template",
    f"{checkout.PACKAGE}.utils.process_data": "process_data",
    f"{checkout.PACKAGE}.utils.checkpoint_resolver": "checkpoint_resolver",
    f"{checkout.PACKAGE}.utils.load_file": "load_file",
    f"{checkout.CLIENTS}.tcp.model_client": _CLIENTS,
    f"{checkout.CLIENTS}.ws.model_client": _CLIENTS,
    f"{checkout.CLIENTS}.ws": _CLIENTS,
}
"""Names of the ecosystem's modules, and the files in `offered` that replace them."""
_PACKAGES = frozenset(
    (
        checkout.PACKAGE,
        f"{checkout.PACKAGE}.utils",
        f"{checkout.PACKAGE}.policy",
        checkout.CLIENTS,
        f"{checkout.CLIENTS}.tcp",
    )
)


class EcosystemFinder:
    """Finds the replacements of ecosystem modules that are not installed.

    Args:
        policy_dir: folder of the adapter, which is importable below `XPolicyLab.policy`.
        root: the real checkout that contains the adapter; None if there is none.
        names: other names by which the adapter imports the checkout, besides `XPolicyLab`.
    """

    def __init__(self, policy_dir: Path, root: Path | None, names: Collection[str] = ()) -> None:
        self._policy_dir = policy_dir
        self._root = root
        self._names = frozenset((checkout.PACKAGE, *names))

    def install(self) -> None:
        """Insert this finder into `sys.meta_path` right after `PathFinder`, in place of an earlier one.

        Finders that replace modules of any name come after it.
        """
        others = [finder for finder in sys.meta_path if not isinstance(finder, EcosystemFinder)]
        place = others.index(PathFinder) + 1 if PathFinder in others else len(others)
        sys.meta_path[:] = [*others[:place], self, *others[place:]]

    def find_spec(
        self,
        name: str,
        path: object = None,  # noqa: ARG002 - of the interface
        target: object = None,  # noqa: ARG002
    ) -> importlib.machinery.ModuleSpec | None:
        """Return the spec of a replacement, or of the checkout under one of its names.

        Args:
            name: full name of the module.
            path: not used; the import system passes it.
            target: not used; the import system passes it.

        Returns:
            None if another finder has to provide the module; with a real checkout, that is all but the checkout itself.
        """
        if name in self._names and self._root is not None:
            return _package(name, self._root)
        if self._root is not None:  # a module that the real checkout lacks is not replaced
            return None
        if name == f"{checkout.PACKAGE}.policy.{self._policy_dir.name}":
            return _package(name, self._policy_dir)
        if name in _PACKAGES:
            return _package(name, None)
        if name in _MODULES:
            file = _OFFERED / f"{_MODULES[name]}.py"
            below: list[str] | None = [] if name in {parent.rpartition(".")[0] for parent in _MODULES} else None
            return importlib.util.spec_from_file_location(name, file, submodule_search_locations=below)
        return None


def _package(name: str, folder: Path | None) -> importlib.machinery.ModuleSpec:
    """Return a package whose own `__init__.py` is not run."""
    found = importlib.machinery.ModuleSpec(name, _NamespaceLoader(), is_package=True)  # type: ignore[arg-type]
    found.submodule_search_locations = [] if folder is None else [str(folder)]
    return found


class _NamespaceLoader:
    """Loads a package that has submodules and no content of its own."""

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:  # noqa: ARG002 - of the interface
        """Return None: the import system creates an ordinary module."""
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing."""
