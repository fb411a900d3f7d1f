"""What an adapter's documents say a run gets: the arguments of the call of eval.sh that they show.

Adapters of the field leave the keys of deploy.yml null that their scripts fill in. Who runs such an adapter without its
scripts, as an audit does, has to know what the scripts would have said.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

import yaml

from xpl import _spec as sdk
from xpl.ecosystem import scripts
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

# Sources: the ecosystem's eval.sh and train.sh, which take these in this order.
_ARGUMENTS: Final = {
    "eval": ("bench_name", "task_name", "ckpt_name", "env_cfg_type", "action_type", "seed"),
    "setup_eval_policy_server": ("bench_name", "task_name", "ckpt_name", "env_cfg_type", "action_type", "seed"),
    "train": ("bench_name", "ckpt_name", "env_cfg_type", "action_type", "seed"),
    "process_data": ("bench_name", "ckpt_name", "env_cfg_type", "action_type"),
}
_CALL: Final = re.compile(r"\b(?P<script>eval|setup_eval_policy_server|train|process_data)\.sh\s+(?P<words>[^\n]+)")
_DOCUMENTS: Final = ("README.md", "INSTALLATION.md", "eval.sh")
_LARGEST: Final = 1 << 20
_OF_THE_SERVER: Final = frozenset((sdk.Deploy.HOST, sdk.Deploy.PORT, sdk.Deploy.POLICY_NAME, sdk.Deploy.PROTOCOL))
_ROBOTS: Final = frozenset(name for key, entry in sdk.EMBODIMENTS.items() for name in (key, *entry.get("aliases", ())))


def run(folder: Path) -> dict[str, Any]:
    """Return keys of deploy.yml with the values that the first documented call of a script gives them.

    Only a call counts that names a robot of the standard in its place; calls of eval.sh come before others. With it
    come the keys that the script which starts the server sets by itself. Empty if there is no such call.
    """
    text = "\n".join(_read(folder / name) for name in _DOCUMENTS).replace("\\\n", " ")
    calls = [(found["script"], found["words"].split()) for found in _CALL.finditer(text)]
    for script, names in _ARGUMENTS.items():
        for called, words in calls:
            given = dict(zip(names, words, strict=False))
            if called == script and given.get(sdk.Deploy.ENV_CFG_TYPE) in _ROBOTS:
                told = {key: word for key, word in given.items() if re.fullmatch(r"[\w./-]+", word)}
                return {key: _value(word) for key, word in {**_by_script(folder, told), **told}.items()}
    return {}


def _by_script(folder: Path, told: Mapping[str, str]) -> dict[str, str]:
    """Return what the server's script makes of what it is called with; not where the server runs, nor who it is."""
    arguments = [told.get(name, "") for name in _ARGUMENTS["setup_eval_policy_server"]]
    found = scripts.settings(folder, [*arguments, "0"])
    return {key: value for key, value in found.items() if key not in _OF_THE_SERVER}


def _value(word: str) -> Any:
    try:
        return spec.parse_yaml(word)
    except yaml.YAMLError:
        return word


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace") if path.stat().st_size <= _LARGEST else ""
    except OSError:
        return ""
