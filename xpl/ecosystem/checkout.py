"""The ecosystem's checkout that an adapter lies in."""

from __future__ import annotations

from pathlib import Path

from xpl import _spec as spec

PACKAGE = "XPolicyLab"
CLIENTS = "client_server"
ENV_CFG = "env_cfg"
_MARK = "model_template.py"
_POLICIES = "policy"


def root_of(policy_dir: Path) -> Path:
    """Return the folder that is the checkout's root, if the adapter lies in one: two above it."""
    return policy_dir.parent.parent


def found(policy_dir: Path) -> Path | None:
    """Return the root of the real checkout that an adapter lies in, whatever its folder is called; None if in none."""
    root = root_of(policy_dir)
    return root if policy_dir.parent.name == _POLICIES and (root / _MARK).is_file() else None


def is_asked(policy_dir: Path) -> bool:
    """Tell whether a module of an adapter, other than vendored ones, mentions the ecosystem's package."""
    for path in sorted(policy_dir.glob("*.py")):
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        if PACKAGE in text and (path.name == spec.File.MODEL_PY or "import" in text):
            return True
    return False
