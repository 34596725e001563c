"""Renamed public names: the old one works for one release and warns with the new one."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


class Renamed:
    """An old name of an attribute, a property or a method: ``prove: ClassVar[Renamed] = Renamed("dot_test")``."""

    old: str

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = f"{owner.__name__}.{name}"
        owner.__annotations__.pop(name, None)  # `dataclass` would read the attribute and cause a warning

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        message = f"{self.old} is called {self.new} now; the next release removes the old name"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return getattr(owner if instance is None else instance, self.new)


def named_arguments(*names: str) -> Callable[[F], F]:
    """Decorate a function to still accept arguments by position that must now be given by name."""

    def decorated(function: F) -> F:
        @wraps(function)
        def called(first: Any, *args: Any, **given: Any) -> Any:
            if args and isinstance(args[0], int):
                what = ", ".join(f"{name}=" for name in names[: len(args)])
                warnings.warn(
                    f"{function.__qualname__} takes {what} by name; the next release refuses them by position",
                    DeprecationWarning, stacklevel=2,
                )  # fmt: skip
                given, args = {**dict(zip(names, args, strict=False)), **given}, ()
            return function(first, *args, **given)

        return cast(F, called)

    return decorated
