"""The method that a name, an instance or a loss stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.errors import BadInput
from vamgpu.losses.loss import Loss
from vamgpu.methods.descent import Descent
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.method import Method
from vamgpu.schema.registry import as_known, family, find, remedy
from vamgpu.targets.limits import Limits

_FAMILY = family("method")
METHODS: dict[str, type[Any]] = {
    "default": find("method", str(_FAMILY.default)), **{name: find("method", name) for name in _FAMILY.nouns}
}  # fmt: skip
"""Names of methods with default parameters: those of the registry, and "default"."""

EFFECTIVE = LBFGS(outside=0.85, inside=1.25, most=1.5, history=20)
"""Default method for an effective dose, which is 1 at the end of the induction."""


def chosen_for(operator: Any, method: str | Method | Loss) -> Method:
    """`chosen`, for an operator; with oxygen, only methods that do not take the dose for linear."""
    if not isinstance(operator, OxygenModel):
        return chosen(method)
    how = EFFECTIVE if method == "default" else chosen(method)
    if not (isinstance(how, LBFGS) or isinstance(how, Descent) and not how.momentum):
        raise BadInput(f"got {how!r} with an OxygenModel, whose dose is not linear in the patterns; expected "
                       '"default", LBFGS(outside=0.85, inside=1.25, most=1.5) or your own loss')  # fmt: skip
    return how


def chosen(method: str | Method | Loss) -> Method:
    """The method for a name, an instance, or a loss to minimize. Raises `BadInput`."""
    if isinstance(method, Loss):
        return Descent(method)
    return instance("method", method, METHODS, "a loss, or an instance such as OSMO()")


def instance(noun: str, given: Any, known: Mapping[str, Callable[[], Any]], other: str) -> Any:
    """The default instance of a known name, or an instance with ``steps``. Raises `BadInput`."""
    if isinstance(given, str):
        name = as_known(given, known)
        if name in known:
            return known[name]()
        hint = remedy(noun, given, known)
        raise BadInput(f"no {noun} {given!r}; there are {', '.join(known)}, or give an instance{hint}")
    if isinstance(given, type) or not hasattr(given, "steps"):
        raise BadInput(f"got {given!r} as {noun}; expected a name ({', '.join(known)}), {other}")
    return given


def check_bodies(method: Method, limits: Limits) -> None:
    """Reject weights of bodies for a method that ignores them."""
    if limits.weighted and not getattr(method, "takes_weights", True):
        able = ", ".join(name for name, kind in METHODS.items() if getattr(kind, "takes_weights", True))
        raise BadInput(
            f"bodies of the target have weights, which {type(method).__name__} ignores; expected 1, or one of "
            f"these methods: {able}, or your own loss"
        )
