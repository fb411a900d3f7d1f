"""Import of Python files by path, each under a unique module name.

Policies, environments, rules and simulators have their own `envs`, `policy`, `utils`: a name made from the file's path
shadows none of them.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType


def load_module(path: Path) -> ModuleType:
    """Load the Python file `path` under a unique module name; its package's relative imports work.

    The folder of the file becomes a package, so that ``from . import sibling`` finds the files beside it. The same
    path always gives the same module object.

    Raises:
        ImportError: if it cannot be loaded as a Python module.
    """
    path = path.resolve()
    folder = path.parent
    package = f"_xpl_content_{folder.name}_{hashlib.sha256(str(folder).encode()).hexdigest()[:8]}"
    if package not in sys.modules:
        register_package(package, folder)
    name = f"{package}.{path.stem}"
    return sys.modules.get(name) or execute(name, path)


def register_package(name: str, folder: Path) -> None:
    """Make a folder a package of this name, without running an ``__init__.py``."""
    package = sys.modules[name] = ModuleType(name)
    package.__path__ = [str(folder)]


def execute(name: str, path: Path) -> ModuleType:
    """Run a Python file as the module `name`; remove the module if it raises.

    Raises:
        ImportError: if it cannot be loaded as a Python module.
    """
    module_spec = importlib.util.spec_from_file_location(name, path)
    if module_spec is None or module_spec.loader is None:
        message = f"{path} cannot be loaded as a Python module"
        raise ImportError(message)
    module = importlib.util.module_from_spec(module_spec)
    sys.modules[name] = module
    try:
        module_spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
