"""Which commands are tools, and how a tool's arguments become a command line.

Nothing is described here a second time: what a tool takes is read from the command's own options.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Final, get_args, get_origin, get_type_hints

from xpl_cli.basics.errors import UserError

_JSON_TYPES: Final[Mapping[Any, str]] = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    Path: "string",
}


_DESTROYING: Final = frozenset(("overwrite", "fix", "out"))
"""Options by which a command replaces files that are there."""


@dataclass(frozen=True)
class Offer:
    """A command that is offered as a tool.

    Attributes:
        command: its name on the command line.
        takes: the arguments and options that the tool takes, by their names without dashes in front. The others are
            about output, which a tool has one of, or about what a tool is not to do.
        reads_only: whether it changes nothing.
    """

    command: str
    takes: tuple[str, ...]
    reads_only: bool = False


OFFERS: Final[Mapping[str, Offer]] = {
    "new_policy": Offer(
        "new-policy",
        ("name", "dir", "embodiment", "action-type", "chunk", "family", "eval-only", "python", "overwrite", "dry-run"),
    ),
    "new_env": Offer("new-env", ("name", "dir", "embodiment", "task", "overwrite", "dry-run")),
    "audit": Offer(
        "audit",
        (
            *("paths", "all", "gate", "select", "ignore", "fix", "changed-since", "keep-going", "fail-on"),
            *("profile", "stub-missing", "task", "episodes", "isolate", "set", "python", "policy-env"),
        ),
    ),
    "explain": Offer("explain", ("names",), reads_only=True),
    "status": Offer("status", ("packages",), reads_only=True),
    "eval_summary": Offer("report", ("runs", "out")),
}
"""Every tool."""


@dataclass(frozen=True)
class Parameter:
    """One argument of a tool.

    Attributes:
        name: for the tool.
        flag: how an option is written; None for an argument that has its place.
        schema: JSON Schema of its values.
        is_required: whether the command cannot do without.
    """

    name: str
    flag: str | None
    schema: Mapping[str, Any]
    is_required: bool

    def words(self, value: Any) -> Iterator[str]:
        """Yield what stands for a value on the command line."""
        for one in value if isinstance(value, list) else [value]:
            if self.flag is None:
                yield str(one)
            elif isinstance(one, bool):
                yield from [self.flag] if one else []
            else:
                yield f"{self.flag}={one}"


@dataclass(frozen=True)
class Tool:
    """A tool.

    Attributes:
        name: of the tool.
        offer: the command behind it.
        description: what the command's help says.
        parameters: what it takes, in the command's order.
    """

    name: str
    offer: Offer
    description: str
    parameters: tuple[Parameter, ...]

    @property
    def overwrites(self) -> bool:
        """Whether it may replace what somebody made: it takes an option that does."""
        return not _DESTROYING.isdisjoint(self.offer.takes)

    @property
    def schema(self) -> dict[str, Any]:
        """JSON Schema of the tool's arguments."""
        return {
            "type": "object",
            "properties": {parameter.name: dict(parameter.schema) for parameter in self.parameters},
            "required": [parameter.name for parameter in self.parameters if parameter.is_required],
            "additionalProperties": False,
        }

    def command_line(self, arguments: Mapping[str, Any]) -> list[str]:
        """Return the arguments of `xpl` that a call stands for.

        Raises:
            UserError: if they do not fit the schema.
        """
        from jsonschema import Draft202012Validator

        for fault in Draft202012Validator(self.schema).iter_errors(dict(arguments)):
            where = ".".join(map(str, fault.absolute_path)) or "the arguments"
            raise UserError(f"{self.name}: {where}: {fault.message}")
        given = [item for item in self.parameters if arguments.get(item.name) is not None]
        options = [word for item in given if item.flag is not None for word in item.words(arguments[item.name])]
        places = [word for item in given if item.flag is None for word in item.words(arguments[item.name])]
        return [self.offer.command, "--json", *options, *(["--", *places] if places else [])]


def tools(root: Any) -> tuple[Tool, ...]:
    """Return every tool, as the commands of this version describe themselves.

    Args:
        root: the whole command line, as typer builds it.
    """
    context = root.make_context(root.name, [], resilient_parsing=True)
    return tuple(_tool(name, offer, root.commands[offer.command], context) for name, offer in OFFERS.items())


def _tool(name: str, offer: Offer, command: Any, parent: Any) -> Tool:
    context = command.make_context(offer.command, [], parent=parent, resilient_parsing=True)
    types = get_type_hints(inspect.unwrap(command.callback))
    known = {_called(parameter): parameter for parameter in command.get_params(context)}
    parameters = tuple(_parameter(known[wanted], types[known[wanted].name]) for wanted in offer.takes)
    description = "\n".join(line for line in (command.help or "").splitlines() if line != "\b")
    return Tool(name, offer, description, parameters)


def _called(parameter: Any) -> str:
    """Return the name of an argument or option without dashes in front."""
    return str(next((name for name in parameter.opts if name.startswith("--")), parameter.name)).lstrip("-")


def _parameter(parameter: Any, annotation: Any) -> Parameter:
    is_option = parameter.param_type_name == "option"
    name = _called(parameter)
    schema = {**_schema(annotation), "description": str(parameter.help or "")}
    return Parameter(name.replace("-", "_"), f"--{name}" if is_option else None, schema, bool(parameter.required))


def _schema(annotation: Any) -> dict[str, Any]:
    """Return the JSON Schema of a parameter of a command; None, its default, is not among its values."""
    wanted: Sequence[Any] = [one for one in get_args(annotation) if one is not NoneType]
    if get_origin(annotation) is list:
        return {"type": "array", "items": _schema(wanted[0])}
    return {"type": _JSON_TYPES[wanted[0] if wanted else annotation]}
