"""Stubs for modules that are not installed, so that the part of an adapter that does not need them can be exercised.

A stub can be imported, subclassed, called, decorated with and passed on; all that it gives are further stubs. It has no
value: to turn one into a number, an array or a list raises `StubError`, and that is remembered, so that an adapter
which catches every exception cannot pass off what it made up as an answer. Its truth value is false.
"""

from __future__ import annotations

import importlib.machinery
import sys
import types
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Callable, NoReturn

from xpl.worker.lacking import is_third_party
from xpl.worker.standins.things import WORLD, StubError


class Stubs:
    """The modules that were stubbed, and whether one of them was taken for the real one.

    Args:
        policy_dir: folder of the adapter.
        roots: folders whose code gets stubs; what libraries import is left to them.
    """

    def __init__(self, policy_dir: Path, roots: Sequence[Path]) -> None:
        self._policy_dir = policy_dir
        self._roots = [str(root.resolve()) + "/" for root in roots]
        self._names: list[str] = []
        WORLD.failed.clear()

    @property
    def names(self) -> list[str]:
        """Top-level names of what was stubbed, in the order of the imports."""
        return list(self._names)

    def install(self) -> None:
        """Have imports that fail give stubs from now on."""
        sys.meta_path.append(self)  # a finder needs no more than find_spec

    def find_spec(
        self,
        name: str,
        path: object = None,  # noqa: ARG002 - of the interface
        target: object = None,  # noqa: ARG002
    ) -> importlib.machinery.ModuleSpec | None:
        """Return the stub of a module that nobody else has; the finders before this one were asked already."""
        top = name.partition(".")[0]
        if top not in self._names:
            if name != top or not self._is_asked_by_adapter() or not is_third_party(top, self._policy_dir):
                return None
            self._names.append(top)
        return importlib.machinery.ModuleSpec(name, self, is_package=True)  # type: ignore[arg-type]

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        """Return a module of which every attribute is a stub."""
        return _StubModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing: a stub has no code."""

    def _is_asked_by_adapter(self) -> bool:
        """Tell whether the code that imports lies in one of the folders; frames of the import system do not count."""
        frame: types.FrameType | None = sys._getframe(1)  # noqa: SLF001 - documented, and only CPython is supported
        while frame is not None:
            file = frame.f_code.co_filename
            if file != __file__ and "importlib" not in file:
                return file.startswith(tuple(self._roots))
            frame = frame.f_back
        return False


def asked() -> str | None:
    """Return what stubs were asked in vain since this was last called, None if they were not."""
    message = WORLD.failed[0] if WORLD.failed else None
    WORLD.failed.clear()
    return message


def check() -> None:
    """Raise the failure of a stub again that nobody heard of.

    Raises:
        StubError: if there was one since the last look.
    """
    message = asked()
    if message is not None:
        raise StubError(message)


def _fail(name: str, what: str) -> NoReturn:
    message = f"{name} has no {what}: {name.partition('.')[0]} is not installed here, and stubbed"
    WORLD.failed.append(message)
    raise StubError(message)


def _is_special(name: str) -> bool:
    return name.startswith("__") and name.endswith("__")


def _refused(what: str) -> Callable[..., NoReturn]:
    def refuse(self: Any, *_: Any, **__: Any) -> NoReturn:
        _fail(_name_of(self), what)

    return refuse


def _name_of(stub: Any) -> str:
    kind = stub if isinstance(stub, type) else type(stub)
    return str(kind.__dict__.get("_xpl_stub") or getattr(kind, "_xpl_stub", "a stub"))


def _given(name: str, arguments: Sequence[Any], named: Any) -> Any:
    """Return what a call of a stub gives: what was decorated, or another stub."""
    if len(arguments) == 1 and not named:
        (only,) = arguments
        is_own_class = isinstance(only, type) and "_xpl_stub" not in only.__dict__ and only.__module__ != "builtins"
        if isinstance(only, types.FunctionType) or is_own_class:
            return only
    return _instance(f"{name}()")


class _StubType(type):
    """Classes that stand for anything a stubbed module may hold: a class, a function, a constant, a submodule."""

    def __getattr__(cls, name: str) -> Any:
        if _is_special(name):
            raise AttributeError(name)
        return _class(f"{_name_of(cls)}.{name}")

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        if "_xpl_stub" in cls.__dict__:
            return _given(_name_of(cls), arguments, named)
        return super().__call__(*arguments, **named)  # a class of the adapter that is derived from one

    def __getitem__(cls, _: Any) -> Any:
        return cls

    def __bool__(cls) -> bool:
        return False

    def __enter__(cls) -> Any:
        return _instance(_name_of(cls))

    def __exit__(cls, *_: object) -> None:
        pass

    __iter__ = _refused("elements")
    __len__ = _refused("length")
    __array__ = _refused("value")
    __float__ = __int__ = __index__ = _refused("value")


class _Stub(metaclass=_StubType):
    """What the objects of stubbed modules are; the adapter may derive from it."""

    _xpl_stub = "a stub"

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __init_subclass__(cls, **_: Any) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        if _is_special(name):
            raise AttributeError(name)
        return _instance(f"{_name_of(self)}.{name}")

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return _given(_name_of(self), arguments, named)

    def __getitem__(self, _: Any) -> Any:
        return _instance(f"{_name_of(self)}[...]")

    def __setitem__(self, _: Any, __: Any) -> None:
        pass

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __bool__(self) -> bool:
        return False

    def __repr__(self) -> str:
        return f"<stub {_name_of(self)}>"

    # numpy leaves operations to the other side.
    __array_ufunc__ = None
    __iter__ = _refused("elements")
    __len__ = _refused("length")
    __array__ = _refused("value")
    __float__ = __int__ = __index__ = __complex__ = __bytes__ = _refused("value")


def _operation(self: Any, *_: Any) -> Any:
    return _instance(_name_of(self))


for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "matmul", "and", "or", "xor"):
    for _form in (f"__{_name}__", f"__r{_name}__"):
        setattr(_Stub, _form, _operation)
for _name in ("neg", "pos", "abs", "invert", "lt", "le", "gt", "ge"):
    setattr(_Stub, f"__{_name}__", _operation)


class _StubModule(ModuleType):
    """A module of which every attribute is a stub."""

    def __getattr__(self, name: str) -> Any:
        if _is_special(name):
            raise AttributeError(name)
        found = _class(f"{self.__name__}.{name}")
        setattr(self, name, found)
        return found


def _class(name: str) -> Any:
    return _StubType(name.rpartition(".")[2], (_Stub,), {"_xpl_stub": name, "__module__": name.rpartition(".")[0]})


def _instance(name: str) -> Any:
    return object.__new__(_class(name))
