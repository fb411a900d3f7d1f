"""Robots that come with `xpl`, from `robots.json`, which `xpl spec compile` writes; read on first use."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from xpl import json_text


def entries() -> dict[str, dict[str, Any]]:
    """Return what is known of every robot, by name."""
    return _all()["robots"]


def words() -> dict[str, Any]:
    """Return what benchmarks call robots where no entry says so, with the robot's name."""
    return _all()["words"]


@cache
def _all() -> dict[str, dict[str, Any]]:
    parts: dict[str, dict[str, Any]] = json_text.parse(Path(__file__).with_name("robots.json").read_bytes())
    return parts
