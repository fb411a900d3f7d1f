"""Recognition of tiny random checkpoints: a file in each says how it was made, and its golden pairs lie beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text
from xpl.checkpoint import TINY, tiny_folder
from xpl_cli.basics.atomic import write_file

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.contract import Config

RECORD: Final = TINY
WORDS: Final = "tiny random weights"
"""What a verdict says."""


def mark(folder: Path, record: Mapping[str, object]) -> None:
    """Write how a tiny checkpoint was made into its folder."""
    write_file(folder / RECORD, f"{json.dumps(record, indent=1, sort_keys=True)}\n".encode())


def find(config: Config, policy_dir: Path) -> Path | None:
    """Return the checkpoint that a configuration names, if it is a tiny one that xpl made."""
    return tiny_folder(config, policy_dir)


def read(folder: Path) -> dict[str, Any]:
    """Return how a tiny checkpoint was made; empty if that cannot be read."""
    try:
        record = json_text.parse((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}
