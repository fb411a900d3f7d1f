"""Things: what stands in for anything that a missing module may hold, and remembers what it was given.

A thing can be imported, called, indexed, derived from, decorated with, annotated with and passed on. It is an instance
also where it stands for a class, so that no metaclass of an adapter's can clash with it. It has no value of its own: a
number comes from its name (`xpl.worker.standins.facts`) or from what was put into it, or it is refused.
"""

from __future__ import annotations

import abc
import copy
import functools
import inspect
import sys
import types
import typing
from collections.abc import Iterator, Mapping
from typing import Any

from xpl.worker.standins import facts as known
from xpl.worker.standins.given import Given, Memory, is_data
from xpl.worker.standins.origins import WORLD, Origin, holds, origin, refuse, value
from xpl.worker.standins.worth import Worth, operation


def _special(name: str) -> bool:
    return name.startswith("__") and name.endswith("__")


def _element(thing: Thing, key: Any) -> Thing:
    told = origin(thing)
    return Thing(Origin(f"{told.name}[...]", told.memory, told.given, (*told.keys, key)))


def _unpacked(depth: int) -> int | None:
    """Return how many names the code that iterates assigns to, None if it does something else."""
    frame = sys._getframe(depth)  # noqa: SLF001 - documented, and only CPython is supported
    code, place = frame.f_code.co_code, frame.f_lasti
    import opcode

    if opcode.opname[code[place]].startswith("UNPACK_SEQUENCE"):
        return code[place + 1]
    return None


class Thing(Worth):
    """What stands in for a class, a function, an object or a value of a module that is not here."""

    __array_ufunc__ = None  # numpy leaves operations to this side

    def __init__(self, *arguments: Any, **_: Any) -> None:
        first = arguments[0] if arguments else None
        if isinstance(first, Origin):
            self.__dict__["_xpl_origin"] = first
        else:
            self.__dict__["_xpl_origin"] = Origin(type(self).__name__, Memory())

    def __init_subclass__(cls, **_: Any) -> None:
        pass

    # -- what it is taken for ------------------------------------------------------------------------------------------

    @property
    def __signature__(self) -> inspect.Signature:
        kinds = inspect.Parameter
        return inspect.Signature([kinds("arguments", kinds.VAR_POSITIONAL), kinds("named", kinds.VAR_KEYWORD)])

    def __mro_entries__(self, bases: tuple[Any, ...]) -> tuple[type, ...]:
        if any(type(base) is Thing for base in bases[: _at(bases, self)]):
            return ()
        plain = all(type(base) in (type, abc.ABCMeta, _Kind, Thing) for base in bases)
        return (_Base if plain else Thing,)

    def __instancecheck__(self, instance: Any) -> bool:
        if type(instance) is Thing:
            return origin(instance).name.endswith(f"{origin(self).name}()") or origin(instance).last[:1].islower()
        return self.__subclasscheck__(type(instance))

    def __subclasscheck__(self, cls: type) -> bool:
        bases = [base for kind in getattr(cls, "__mro__", ()) for base in kind.__dict__.get("__orig_bases__", ())]
        return any(isinstance(base, Thing) and origin(base).name == origin(self).name for base in bases)

    def __or__(self, other: Any) -> Any:
        return operation(self, "or", other) if holds(self) else typing.Any

    __ror__ = __or__

    def __class_getitem__(cls, _: Any) -> Any:
        return cls

    @classmethod
    def __get_pydantic_core_schema__(cls, *_: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.any_schema()

    # -- parts ---------------------------------------------------------------------------------------------------------

    def __getattr__(self, name: str) -> Any:
        if _special(name):
            raise AttributeError(name)
        if name.startswith(("_xpl", "_pytest")):
            raise AttributeError(name)
        told = origin(self)
        if told.given is not None:
            found = _of_value(self, name)
            if found is not None:
                return found
            return Thing(Origin(f"{told.name}.{name}", told.memory, told.given, (*told.keys, name)))
        child = _named(f"{told.name}.{name}", told.memory, told.is_name)
        self.__dict__[name] = child
        return child

    def __setattr__(self, name: str, new: Any) -> None:
        if new is None:  # how state is dropped
            origin(self).memory.clear()
        object.__setattr__(self, name, new)

    def __getitem__(self, key: Any) -> Any:
        told = origin(self)
        made = told.given
        if made is not None:
            if isinstance(key, str):
                found = made.entry((*told.keys, key))
                return _element(self, key) if found is None else found
            array = value(self)
            return array[key] if array is not None else _element(self, key)
        if told.is_name and not isinstance(key, str):
            return self  # a generic class
        try:
            return self.__dict__.setdefault("_xpl_parts", {})[key]
        except (KeyError, TypeError):
            worth = value(self) if isinstance(key, (int, slice, tuple)) else None
            if worth is not None:
                return worth[key]
            part = Thing(Origin(f"{told.name}[...]", told.memory, None, (*told.keys, key), is_text=told.is_text))
            if isinstance(key, (str, int)):
                self.__dict__["_xpl_parts"][key] = part
            return part

    def __setitem__(self, key: Any, new: Any) -> None:
        if isinstance(key, (str, int)):
            self.__dict__.setdefault("_xpl_parts", {})[key] = new

    def __delitem__(self, key: Any) -> None:
        self.__dict__.setdefault("_xpl_parts", {}).pop(key, None)

    def get(self, key: Any, default: Any = None) -> Any:
        """Look up as a map does; a default that says something is the better guess."""
        if not holds(self) and WORLD.facts is not None:
            if key in self.__dict__.get("_xpl_parts", {}):
                return self.__dict__["_xpl_parts"][key]
            if default is not None:
                return default
        return self[key]

    def __contains__(self, key: Any) -> bool:
        if holds(self):
            told = origin(self)
            keys = told.given.keys(told.keys) if told.given is not None else None
            return True if keys is None else key in keys
        if WORLD.facts is None:
            refuse(origin(self).name, "elements")
        return isinstance(key, str)

    def keys(self) -> Any:
        """Return the keys of the map that went in, if one did."""
        told = origin(self)
        found = told.given.keys(told.keys) if told.given is not None else None
        if found is None and told.given is not None and not told.keys:
            found = told.given.encoded()
        if found is None:
            found = list(self.__dict__.get("_xpl_parts", {}))
            if not found and WORLD.facts is not None and known.STATISTICS.search(f"{told.name}.{told.keys}".lower()):
                found = list(known.STATISTIC)
            elif not found and WORLD.documents and not told.is_name:
                found = list(WORLD.documents)
        return found

    def items(self) -> Any:
        """Return the entries of the map that went in."""
        return [(key, self[key]) for key in self.keys()]

    def values(self) -> Any:
        """Return the values of the map that went in."""
        return [self[key] for key in self.keys()]

    # -- calls ---------------------------------------------------------------------------------------------------------

    def _xpl_again(self) -> Thing:
        told = origin(self)
        return Thing(Origin(told.name, told.memory, told.given, told.keys))

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return called(self, arguments, named)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    # -- values --------------------------------------------------------------------------------------------------------

    def __bool__(self) -> bool:
        return holds(self)

    def __iter__(self) -> Iterator[Any]:
        count = _unpacked(2)
        told = origin(self)
        if count is not None and WORLD.facts is not None:
            if told.given is None:
                return iter([_element(self, place) for place in range(count)])
            # the first of several answers is the actions; the rest tells about them
            return iter([self, *(Thing(Origin(f"{told.name}[{n}]", Memory())) for n in range(1, count))])
        if told.given is not None:
            keys = told.given.keys(told.keys)
            if keys is not None:
                return iter(keys)
            if not told.keys and told.given.is_of_image():
                return iter(["pixel_values"])  # what a processor of images gives is a map
        found = value(self)
        if found is None or not hasattr(found, "__iter__"):
            refuse(told.name, "elements")
        return iter(found)

    def __len__(self) -> int:
        found = value(self)
        if found is None or not hasattr(found, "__len__"):
            if WORLD.facts is not None and not holds(self) and "_xpl_parts" in self.__dict__:
                return len(self.__dict__["_xpl_parts"])
            refuse(origin(self).name, "length")
        return len(found)

    def __next__(self) -> Any:
        if WORLD.facts is None:
            refuse(origin(self).name, "elements")
        return Thing(Origin(f"{origin(self).name}.next", origin(self).memory))

    def __copy__(self) -> Any:
        return self

    def __deepcopy__(self, memory: Any) -> Any:
        if type(self) is Thing:
            return self
        made = type(self).__new__(type(self))
        memory[id(self)] = made
        made.__dict__.update(
            {name: copy.deepcopy(item, memory) for name, item in self.__dict__.items() if name != "_xpl_origin"}
        )
        return made

    def __reduce__(self) -> Any:
        refuse(origin(self).name, "value")


class _Kind(abc.ABCMeta):
    """Classes that derive from things have what things have."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return _named(f"{cls.__name__}.{name}", Memory(), is_name=True)


class _Base(Thing, metaclass=_Kind):
    pass


def _at(bases: tuple[Any, ...], base: Any) -> int:
    return next(place for place, other in enumerate(bases) if other is base)


def _of_value(thing: Thing, name: str) -> Any:
    """Return what an array or a tensor offers under a name, if that is what a thing with data is asked for."""
    if name not in _ARRAY or WORLD.value is None:
        return None
    found = getattr(value(thing), name, None)
    if name not in _SHAPING or not callable(found):
        return found

    def shaped(*arguments: Any, **named: Any) -> Any:
        try:
            return found(*arguments, **named)
        except (TypeError, ValueError, RuntimeError, IndexError):  # a shape that only the real one has
            return thing

    return shaped


_SHAPING = frozenset(("squeeze unsqueeze reshape view permute transpose flatten expand repeat swapaxes ").split())
_ARRAY = frozenset(
    (
        "shape ndim dtype size T device numpy cpu cuda to float double half bfloat16 int long bool squeeze unsqueeze "
        "reshape view permute transpose flatten detach clone copy astype tolist item mean sum min max clip clamp dim "
        "is_floating_point contiguous expand repeat ne eq type tobytes ravel swapaxes movedim unbind split chunk "
    ).split()
)


def _named(name: str, memory: Memory, is_name: bool) -> Any:
    last = name.rpartition(".")[2]
    if is_name and last.endswith(("Error", "Exception", "Warning", "Interrupt")) and last[:1].isupper():
        return type(last, (Exception,), {"__module__": name.rpartition(".")[0]})
    if is_name:
        found = WORLD.makes(name)
        if found is not None:
            return found
    return Thing(Origin(name, memory, is_name=is_name))


def called(thing: Any, arguments: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
    """Return what calling a thing gives: what was decorated, itself, an answer, or another thing."""
    told = origin(thing)
    last = told.last
    if len(arguments) == 1 and not named:
        (only,) = arguments
        own = isinstance(only, type) and only.__module__ != "builtins"
        if isinstance(only, (types.FunctionType, classmethod, staticmethod, functools.partial)) or own:
            return only
    if WORLD.facts is None:
        return Thing(Origin(f"{told.name}()", told.memory))
    if last in known.SAME:
        return (
            Thing(Origin(told.name.rpartition(".")[0] or told.name, told.memory, told.given, told.keys[:-1]))
            if (told.given is not None)
            else told.memory.owner or thing
        )
    if known.RESETS.fullmatch(last):
        told.memory.clear()
        return Thing(Origin(f"{told.name}()", told.memory))
    if told.name.endswith(")"):
        speaks = known.TRANSFORMS.fullmatch(last.lower()) or known.EMBEDS.fullmatch(last)
        last = "__call__" if (last[:1].isupper() and not speaks) or last == "from_pretrained" else last
    if last in ("forward", "apply", "__call__"):  # of a normaliser, a processor ...
        whose = told.name.rpartition(".")[0].rpartition(".")[2].partition("(")[0]
        last = whose if known.TRANSFORMS.fullmatch(whose.lower()) else last
    is_class = (last[:1].isupper() and not told.name.endswith(")")) or last == "from_pretrained"
    shown = WORLD.serving or bool(known.TRANSFORMS.fullmatch(last.lower()))
    if shown and is_data((arguments, dict(named)), texts=WORLD.serving):
        given = Given(last, arguments, dict(named), told.memory, before=told.given, owner=told.owner)
        if not is_class and WORLD.serving:
            told.memory.remember(given)
        return Thing(Origin(f"{told.name}()", Memory() if is_class else told.memory, given))
    if told.given is not None:
        return Thing(Origin(f"{told.name}()", told.memory, told.given, told.keys))
    if WORLD.serving and not is_class and known.ANSWERS.fullmatch(last) and told.memory.given:
        return Thing(Origin(f"{told.name}()", told.memory, Given(last, arguments, dict(named), told.memory)))
    memory = Memory() if is_class or told.is_name else told.memory
    made = Thing(Origin(f"{told.name}()", memory))
    if is_class or told.is_name:
        memory.owner = made
    return made
