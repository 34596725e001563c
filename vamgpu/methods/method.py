"""The protocol of methods: frozen parameters and a generator of steps."""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol

if TYPE_CHECKING:
    from vamgpu.methods.state import OptimizerState


Steps = Generator[tuple[float, float], None, None]
"""Loss and strict window after every step."""

Criterion = Literal["window", "loss"]
"""Criterion of better patterns: the greater strict window, or the lower loss."""


class Method(Protocol):
    """A way to find light for a target; the values here are those of a method that minimizes a loss.

    Attributes:
        papers: Citations of its sources.
        iterations: Default number of iterations.
        cost: Least projector evaluations of an iteration.
        criterion: Criterion of its best light: the strict window for methods of thresholds, the loss for methods that
            minimize a loss. With weights or gray bodies it is the loss for all methods.
        takes_start: Optional; whether the method starts from ``light`` in the memory, if there is any. Without it,
            `optimize` rejects a ``start``.
        takes_weights: Optional; whether weights of bodies change the result, as in all methods that minimize
            ``state.loss``. If it is False, `optimize` rejects them.
    """

    papers: ClassVar[tuple[str, ...]] = ()
    iterations: ClassVar[int]
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "loss"

    def steps(self, state: OptimizerState) -> Steps:
        """Improve ``light`` in the memory without end, or until no gain is left.

        ``state.offer`` receives every light whose dose is known, and stores the best. At every yield, ``state.memory``
        contains everything that a later run needs to continue.

        Args:
            state: State of the run.

        Yields:
            Loss and strict window of the step.
        """
        ...
