"""Arguments of a run from an adapter's documents: those of the eval.sh call that they show.

Existing adapters leave keys of deploy.yml null that their scripts fill in. Running such an adapter without its scripts,
as an audit does, needs the values that the scripts would set.
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

# The call with the most arguments comes first.
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
    """Return the keys of deploy.yml that the first documented call of a script sets.

    A call counts only if it has a robot of the standard in the right position; calls of eval.sh are preferred. The
    result includes keys that the server's start script sets by itself. Empty if there is no such call.
    """
    text = "\n".join(_read(folder / name) for name in _DOCUMENTS).replace("\\\n", " ")
    calls = [(match["script"], match["words"].split()) for match in _CALL.finditer(text)]
    for script in _SCRIPTS:
        for called, words in calls:
            arguments = dict(zip(_arguments(script), words, strict=False))
            if called == script and arguments.get(sdk.Deploy.ENV_CFG_TYPE) in robots.names():
                values = {key: word for key, word in arguments.items() if re.fullmatch(r"[\w./-]+", word)}
                return {key: _value(word) for key, word in {**_by_script(folder, values), **values}.items()}
    return {}


def _arguments(script: str) -> tuple[str, ...]:
    """Return the leading arguments of a script that are keys of deploy.yml."""
    return tuple(takewhile(_OF_A_RUN.__contains__, spec.data("package")["scripts"][script]))


def _by_script(folder: Path, values: Mapping[str, str]) -> dict[str, str]:
    """Return the settings that the server's script derives from its arguments, but for its address and name."""
    arguments = [values.get(name, "") for name in _arguments(sdk.File.SETUP_EVAL_POLICY_SERVER_SH)]
    settings = scripts.settings(folder, [*arguments, "0"])
    return {key: value for key, value in settings.items() if key not in _OF_THE_SERVER}


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
