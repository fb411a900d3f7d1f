"""Commands with their own conversion of simple values: typer's conversion imports pydantic, which is slow.

Recent releases of typer convert every parameter with pydantic, whose import takes longer than the static gate. Other
releases, and values of other types, are not affected.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from typer.core import TyperCommand, TyperGroup

from xpl_cli.commands import values

_NUMBER: Final = re.compile(r"[+-]?[0-9]{1,15}(\.[0-9]{1,15})?")


def _number(kind: type[float]) -> Callable[[Any], Any]:
    """Return a converter of plain numbers, which raises ValueError for others."""

    def convert(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        if _NUMBER.fullmatch(value) is None:
            raise ValueError(value)
        return kind(value)

    return convert


_CONVERSIONS: Final[dict[Any, Callable[[Any], Any]]] = {
    str: values.text,
    Path: values.path,
    int: _number(int),
    float: _number(float),
    list[str]: lambda given: [values.text(value) for value in given],
    list[Path]: lambda given: [values.path(value) for value in given],
}


class PlainCommand(TyperCommand):
    """A command with plain parameters."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, that of `--help` included."""
        return _make_plain(super().get_params(ctx))


class PlainGroup(TyperGroup):
    """A command group with plain parameters."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, that of `--help` included."""
        return _make_plain(super().get_params(ctx))


def _make_plain(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        annotation = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)
        is_ready = "get_runtime_param" in vars(parameter) or not hasattr(parameter, "get_runtime_param")
        if not is_ready and (annotation is bool or annotation in _CONVERSIONS):
            is_bounded = annotation in {int, float} and _is_bounded(parameter)
            convert = None if is_bounded else _CONVERSIONS.get(annotation)
            plain = _PlainConverter(convert, parameter.get_runtime_param)
            parameter.get_runtime_param = lambda plain=plain: plain
    return parameters


def _is_bounded(parameter: Any) -> bool:
    declared = parameter.type_descriptor.parameter_info
    return declared.min is not None or declared.max is not None


class _PlainConverter:
    """Converter of one parameter's values, as typer calls it.

    Args:
        convert: converts a given value; None to use typer's converter.
        usual: returns typer's converter.
    """

    def __init__(self, convert: Callable[[Any], Any] | None, usual: Callable[[], Any]) -> None:
        self._convert = convert
        self._usual = usual

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the value of a parameter; missing multiple values are empty."""
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if self._convert is not None:
            with contextlib.suppress(ValueError):
                return values.number(self._convert(value))
        return values.number(self._usual().coerce(value, param=param, ctx=ctx))
