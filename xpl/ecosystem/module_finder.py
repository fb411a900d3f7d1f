"""A finder behind those of files: it gives the ecosystem's modules where no real ones were found before it."""

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
"""Names of modules, and the files of ours that stand for them."""
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
    """Finds what lacks of the ecosystem.

    Args:
        policy_dir: folder of the adapter, which is importable below `XPolicyLab.policy`.
        root: the real checkout that it lies in, None if in none.
        names: what it calls the checkout, besides `XPolicyLab`.
    """

    def __init__(self, policy_dir: Path, root: Path | None, names: Collection[str] = ()) -> None:
        self._policy_dir = policy_dir
        self._root = root
        self._names = frozenset((checkout.PACKAGE, *names))

    def install(self) -> None:
        """Install this finder after those of files, in place of an earlier one.

        What stands in for modules that are nowhere comes after it.
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
        """Return a module of ours, or the checkout as a package where its folder is called otherwise."""
        if name in self._names and self._root is not None:
            return _package(name, self._root)
        if self._root is not None:  # what a real checkout lacks is not made up
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
    """Loads a package that holds nothing but what lies below it."""

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:  # noqa: ARG002 - of the interface
        """Return None, for a module as usual."""
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing."""
