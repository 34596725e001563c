"""Renamed public names: the old one works for one release and warns with the new one."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from typing import Any, TypeVar, cast

from vamgpu.errors import BadInput

F = TypeVar("F", bound=Callable[..., Any])


def renamed(module: str, names: Mapping[str, str], otherwise: Callable[[str], Any] | None = None) -> Callable[..., Any]:
    """Make the ``__getattr__`` of a module that still answers to old names; ``otherwise`` looks up any other."""
    # ``__getattr__ = renamed(__name__, {"Carried": "CoRotatingMedium", "Work": "vamgpu.hosts.jobs.PrintJob"})``

    def look_up(name: str) -> Any:
        if name in names:
            home, _, new = names[name].rpartition(".")
            warn_renamed(f"{module}.{name}", f"{home or module}.{new}", stacklevel=3)
            return getattr(import_module(home or module), new)
        if otherwise is not None:
            return otherwise(name)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return look_up


class Renamed:
    """An old name of an attribute, a property or a method: ``prove: ClassVar[Renamed] = Renamed("dot_test")``."""

    old: str

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = f"{owner.__name__}.{name}"
        owner.__annotations__.pop(name, None)  # `dataclass` would look at what it names, and be warned

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        warn_renamed(self.old, self.new, stacklevel=3)
        return getattr(owner if instance is None else instance, self.new)


def renamed_arguments(**names: str) -> Callable[[F], F]:
    """Decorate a function or a class to take keyword arguments by old names: ``@renamed_arguments(old="new")``."""

    def decorated(function: F) -> F:
        if isinstance(function, type):
            function.__init__ = decorated(cast(Any, function.__init__))
            return cast(F, function)

        @wraps(function)
        def called(*args: Any, **given: Any) -> Any:
            for old in names.keys() & given.keys():
                new, what = names[old], f"the argument {old} of {function.__qualname__}"
                if new in given:
                    raise BadInput(f"got {new} and {what}, its old name; expected {new} alone")
                warn_renamed(what, new)
                given[new] = given.pop(old)
            return function(*args, **given)

        return cast(F, called)

    return decorated


def named_arguments(*names: str) -> Callable[[F], F]:
    """Decorate a function to take by place, behind its first argument, what it takes by name alone now."""

    def decorated(function: F) -> F:
        @wraps(function)
        def called(first: Any, *args: Any, **given: Any) -> Any:
            if args and isinstance(args[0], int):
                what = ", ".join(f"{name}=" for name in names[: len(args)])
                warnings.warn(
                    f"{function.__qualname__} takes {what} by name; their places go with the next release",
                    DeprecationWarning, stacklevel=2,
                )  # fmt: skip
                given, args = {**dict(zip(names, args, strict=False)), **given}, ()
            return function(first, *args, **given)

        return cast(F, called)

    return decorated


def warn_renamed(old: str, new: str, stacklevel: int = 3, category: type[Warning] = DeprecationWarning) -> None:
    """Warn that ``old`` is called ``new`` now; ``category`` is `FutureWarning` for words of files."""
    message = f"{old} is called {new} now; the old name goes with the next release"
    warnings.warn(message, category, stacklevel=stacklevel)
