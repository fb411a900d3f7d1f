"""What an adapter's documents say a run gets: the arguments of the call of eval.sh that they show.

Adapters of the field leave the keys of deploy.yml null that their scripts fill in. Who runs such an adapter without its
scripts, as an audit does, has to know what the scripts would have said.
"""

from __future__ import annotations

import re
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final

import yaml

from xpl import _spec as sdk
from xpl import robots
from xpl.ecosystem import scripts
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

# The call that says most comes first.
_SCRIPTS: Final = (
    sdk.File.EVAL_SH,
    sdk.File.SETUP_EVAL_POLICY_SERVER_SH,
    sdk.File.TRAIN_SH,
    sdk.File.PROCESS_DATA_SH,
)
_OF_A_RUN: Final = frozenset((sdk.Deploy.TASK_NAME, *sdk.CHECKPOINT_RUN_NAME))
_CALL: Final = re.compile(rf"\b(?P<script>{'|'.join(map(re.escape, _SCRIPTS))})\s+(?P<words>[^\n]+)")
_DOCUMENTS: Final = (sdk.File.README_MD, "INSTALLATION.md", sdk.File.EVAL_SH)
_LARGEST: Final = 1 << 20
_OF_THE_SERVER: Final = frozenset((sdk.Deploy.HOST, sdk.Deploy.PORT, sdk.Deploy.POLICY_NAME, sdk.Deploy.PROTOCOL))


def documented_arguments(folder: Path) -> dict[str, Any]:
    """Return keys of deploy.yml with the values that the first documented call of a script gives them.

    Only a call counts that names a robot of the standard in its place; calls of eval.sh come before others. With it
    come the keys that the script which starts the server sets by itself. Empty if there is no such call.
    """
    text = "\n".join(_read(folder / name) for name in _DOCUMENTS).replace("\\\n", " ")
    calls = [(found["script"], found["words"].split()) for found in _CALL.finditer(text)]
    for script in _SCRIPTS:
        for called, words in calls:
            given = dict(zip(_arguments(script), words, strict=False))
            if called == script and given.get(sdk.Deploy.ENV_CFG_TYPE) in robots.names():
                told = {key: word for key, word in given.items() if re.fullmatch(r"[\w./-]+", word)}
                return {key: _value(word) for key, word in {**_by_script(folder, told), **told}.items()}
    return {}


def _arguments(script: str) -> tuple[str, ...]:
    """Return the keys of deploy.yml that a script takes first, in its order."""
    return tuple(takewhile(_OF_A_RUN.__contains__, spec.data("package")["scripts"][script]))


def _by_script(folder: Path, told: Mapping[str, str]) -> dict[str, str]:
    """Return what the server's script makes of what it is called with; not where the server runs, nor who it is."""
    arguments = [told.get(name, "") for name in _arguments(sdk.File.SETUP_EVAL_POLICY_SERVER_SH)]
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
