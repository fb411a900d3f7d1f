"""Keys of the standard that reach no code of an adapter."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from xpl import _spec as sdk

if TYPE_CHECKING:
    from xpl_cli.audit.static.model_class import ModelClass


def is_unread(adapter: ModelClass, key: str) -> bool:
    """Tell whether neither the adapter, nor helpers that get its configuration, nor its server's script use a key.

    A script that only hands it on or prints it does not use it.
    """
    source = adapter.source
    if adapter.config_escapes or adapter.config_helpers or not adapter.settings:
        return False
    for name in source.python_files:
        nodes = source.nodes(name) if source.parses(name) else ()
        if any(key in (getattr(node, "value", None), getattr(node, "attr", None)) for node in nodes):
            return False
    script = sdk.File.SETUP_EVAL_POLICY_SERVER_SH
    lines = source.text(script).split("\n") if source.has(script) else []
    used = (line for line in lines if re.search(rf"\$\{{?{key}\b", line))
    return not any(not re.search(rf"\b{key}=|^\s*(?:echo|printf)\b", line) for line in used)
