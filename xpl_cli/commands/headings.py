"""The command line's help, with its commands under the rooms that they live in.

A command's heading is the folder of its module below `xpl_cli/commands`: nothing has to be said twice.
"""

from __future__ import annotations

from typing import Any, Final

from xpl_cli.commands.plain import PlainGroup

HEADINGS: Final = ("scaffold", "prove", "run", "data", "report", "agents", "maintain")
"""Folders of commands, in the order in which one meets them."""


class HeadedGroup(PlainGroup):
    """A group that lists its commands by their rooms."""

    def headed(self) -> dict[str, dict[str, Any]]:
        """Return the commands that are not hidden, by their names, under each heading that has some."""
        found: dict[str, dict[str, Any]] = {heading: {} for heading in HEADINGS}
        for name, command in self.commands.items():
            if not command.hidden:
                found[_room(command)][name] = command
        return {heading.capitalize(): commands for heading, commands in found.items() if commands}

    def format_commands(self, _ctx: Any, formatter: Any) -> None:
        """Write each heading with its commands below; all of them in one column."""
        headed = self.headed()
        width = max(len(name) for commands in headed.values() for name in commands)
        for heading, commands in headed.items():
            with formatter.section(heading):
                room = formatter.width - width - 6
                rows = [(name.ljust(width), command.get_short_help_str(room)) for name, command in commands.items()]
                formatter.write_dl(rows)


def _room(command: Any) -> str:
    """Return the folder of a command's module; that of its first command for a group."""
    while hasattr(command, "commands"):
        command = next(iter(command.commands.values()))
    room: str = command.callback.__module__.split(".")[2]
    return room
