"""Help of `xpl`, which lists the commands by groups: a group is the folder of a command's module in this package."""

from __future__ import annotations

import re
from typing import Any, Final

from xpl_cli.commands.plain import PlainGroup

HEADINGS: Final = ("scaffold", "prove", "run", "data", "report", "agents", "maintain")
"""Folders of commands, in the order of the help."""


class HeadedGroup(PlainGroup):
    """A command group that lists its commands under headings, in at most a screen."""

    def get_help(self, ctx: Any) -> str:
        """Return the help text without blank lines between its sections."""
        return re.sub(r"\n\n(?=[A-Z][a-z]+:\n  )", "\n", super().get_help(ctx))

    def headed(self) -> dict[str, dict[str, Any]]:
        """Return the visible commands by heading and name, without empty headings."""
        groups: dict[str, dict[str, Any]] = {heading: {} for heading in HEADINGS}
        for name, command in self.commands.items():
            if not command.hidden:
                groups[_heading(command)][name] = command
        return {heading.capitalize(): commands for heading, commands in groups.items() if commands}

    def format_commands(self, _ctx: Any, formatter: Any) -> None:
        """Write each heading with its commands, all in one column."""
        headed = self.headed()
        width = max(len(name) for commands in headed.values() for name in commands)
        for heading, commands in headed.items():
            with formatter.section(heading):
                limit = formatter.width - width - 6
                rows = [(name.ljust(width), command.get_short_help_str(limit)) for name, command in commands.items()]
                formatter.write_dl(rows)


def _heading(command: Any) -> str:
    """Return the folder of a command's module; for a group, that of its first command."""
    while hasattr(command, "commands"):
        command = next(iter(command.commands.values()))
    folder: str = command.callback.__module__.split(".")[2]
    return folder
