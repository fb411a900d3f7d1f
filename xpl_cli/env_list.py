"""What environment packages offer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli import content, environments
from xpl_cli.env_check import unsupported

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SCHEMA = "xpl.env-list/1"


def offers(name: str | None = None) -> list[dict[str, Any]]:
    """Return what one environment, or each one, offers: tasks with the embodiments they can be played with.

    Raises:
        NotFoundError: there is no environment of this name.
    """
    if name is not None:
        return [_offer(environments.find(name))]
    rooms = (Path("envs"), content.room("envs"))
    names = sorted({entry.parent.name for room in rooms for entry in room.glob("*/env.yml")})
    return [_offer(environments.find(each)) for each in names]


def text(found: Sequence[Mapping[str, Any]]) -> str:
    """Return the list for people."""
    return "\n\n".join("\n".join(_lines(offer)) for offer in found)


def _offer(folder: Path) -> dict[str, Any]:
    facts = environments.manifest(folder)
    tasks = {
        task: {
            sdk.Obs.INSTRUCTION: entry[sdk.Obs.INSTRUCTION],
            "dimension": entry.get("dimension"),
            "max_steps": entry["max_steps"],
            "embodiments": [robot for robot in facts["embodiments"] if unsupported(entry, robot) is None],
        }
        for task, entry in facts["tasks"].items()
    }
    return {
        "name": facts["name"],
        "title": facts["title"],
        "action_types": facts["action_types"],
        "settings": facts.get("settings", ["clean"]),
        "embodiments": facts["embodiments"],
        "tasks": tasks,
    }


def _lines(offer: Mapping[str, Any]) -> list[str]:
    width = max(map(len, offer["tasks"]))
    every = offer["embodiments"]
    lines = [
        f"{offer['name']}: {offer['title']}",
        f"  embodiments: {', '.join(every)}",
        f"  control: {', '.join(offer['action_types'])}; settings: {', '.join(offer['settings'])}",
    ]
    for task, entry in offer["tasks"].items():
        missing = [robot for robot in every if robot not in entry["embodiments"]]
        note = f" (not {', '.join(missing)})" if missing else ""
        lines.append(f"  {task.ljust(width)}  {entry[sdk.Obs.INSTRUCTION]}{note}")
    return lines
