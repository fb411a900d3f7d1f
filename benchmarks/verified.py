"""Verified defects of public adapters, and the rules about each class of them.

A list of defects is a JSON file with `defects`: adapter, file, line and defect_class of each. A defect counts as found
by the static gate if a finding of a rule for its class lies in the same file, at most 40 lines away, or anywhere in it
if the rule is about something missing. Findings of the offline gate are about behaviour, which has no line: there the
class is enough.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

NEAR = 40
"""Lines between a finding and the defect that it is about."""

ANYWHERE = frozenset(("XPL101", "XPL196"))
"""Rules about what is not there, which has no line."""

_OFFLINE = 200  # numbers of rules from here on are of gates that run the adapter

ABOUT: dict[str, tuple[int, ...]] = {
    "action_type": (149, 202),
    "bare except": (131,),
    "batch misalignment: unknown": (111, 203, 204, 205, 207),
    "batch misalignment": (109, 203, 204, 205, 207, 218, 219, 220),
    "batch: per-env": (113, 203, 207, 218, 219),
    "bool()": (117, 249),
    "channel": (121, 191, 225),
    "checkpoint step": (126, 251),
    "config value": (120,),
    "counter survives": (115, 208, 209),
    "credential": (130,),
    "custom RPC": (135,),
    "dead config": (120,),
    "defaults set only in reset": (145, 254),
    "device": (153,),
    "empty env_idx_list": (110, 204),
    "env_idx": (112, 206),
    "exact-zero": (173,),
    "hard-coded action": (125, 202),
    "hard-coded env count": (172, 205),
    "hard-coded internal proxy": (130,),
    "hard-coded robot default": (125, 154),
    "hard-coded": (125,),
    "inference mutates": (140, 141, 211, 226),
    "instruction ignored": (196, 212, 215, 220),
    "internal": (130,),
    "language silently": (147,),
    "merge-conflict": (102,),
    "mirror": (130,),
    "missing action key": (124,),
    "missing camera": (123, 213),
    "missing contract": (105, 203),
    "model-side cache": (115, 208),
    "mutates checkpoint": (127, 252),
    "no episode-end": (134,),
    "normalisation silently": (148,),
    "normalisation stats": (126, 148),
    "null in deploy.yml": (119, 250),
    "partial weight": (128,),
    "possible infinite loop": (169,),
    "print on": (132,),
    "relative path": (129,),
    "required file": (101,),
    "reset failure": (116, 224),
    "reset": (115, 208, 209),
    "rotation singularity": (151, 240),
    "run seed": (118, 214, 248),
    "seed 0": (118, 214, 248),
    "shared CWD": (129,),
    "single-arm": (152,),
    "state truncated": (125,),
    "task-specific default": (154, 196),
    "train/eval channel": (122,),
    "un-normalised": (148,),
    "unbounded": (142, 223),
    "unsupported action_type": (149, 202),
    "wrong RPC": (135, 106),
    "wrong config key": (120,),
    "wrong env_cfg": (161, 201),
    "wrong sys.path": (161,),
}
"""Beginnings of a defect's class, the longest that fits counts, and the numbers of the rules that are about it."""


def is_about(finding: dict[str, Any], defect: dict[str, Any]) -> bool:
    """Return whether a finding, with its code, path, line and message, is about a verified defect."""
    starts = [start for start in ABOUT if defect["defect_class"].startswith(start)]
    number = int(finding["code"][3:])
    if not starts or number not in ABOUT[max(starts, key=len)]:
        return False
    if number >= _OFFLINE:
        return True
    if finding["path"] is None:
        return Path(str(defect["file"])).name in finding["message"]
    if not str(finding["path"]).endswith(str(defect["file"]).split("/", 1)[1]):
        return False
    return finding["code"] in ANYWHERE or abs((finding["line"] or 0) - (defect["line"] or 0)) <= NEAR
