"""The ecosystem's checkout that contains an adapter."""

from __future__ import annotations

import re
from pathlib import Path

from xpl import _spec as spec

PACKAGE = "XPolicyLab"
CLIENTS = "client_server"
ENV_CFG = "env_cfg"
_MARK = "model_template.py"
_POLICIES = "policy"


def root_of(policy_dir: Path) -> Path:
    """Return the folder two levels above an adapter: the checkout's root, if the adapter is in a checkout."""
    return policy_dir.parent.parent


def find_root(policy_dir: Path) -> Path | None:
    """Return the root of the checkout that contains an adapter, whatever its name; None if there is none."""
    root = root_of(policy_dir)
    return root if policy_dir.parent.name == _POLICIES and (root / _MARK).is_file() else None


def names(policy_dir: Path) -> frozenset[str]:
    """Return the names by which an adapter imports the ecosystem's package; empty if it does not.

    They are the package's name and, in a checkout of another name, that of its folder. Vendored modules do not count.
    """
    texts = {path.name: _text(path) for path in policy_dir.glob("*.py")}
    called = {
        PACKAGE for name, text in texts.items() if PACKAGE in text and (name == spec.File.MODEL_PY or "import" in text)
    }
    root = find_root(policy_dir)
    if root is not None and root.name.isidentifier():
        called |= {root.name for text in texts.values() if _is_imported(root, text)}
    return frozenset(called)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _is_imported(root: Path, text: str) -> bool:
    """Return whether code imports a part of a checkout by the name of its folder."""
    wanted = re.compile(rf"^\s*(?:from|import)\s+{root.name}(?:\.|\s+import\s+)(\w+)", re.MULTILINE)
    return any((root / part).is_dir() or (root / f"{part}.py").is_file() for part in wanted.findall(text))
