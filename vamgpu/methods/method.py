"""What every method is: a frozen choice of parameters and a generator of steps."""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol

if TYPE_CHECKING:
    from vamgpu.methods.state import OptimizerState


Steps = Generator[tuple[float, float], None, None]
"""Loss and strict window after every step."""

Criterion = Literal["window", "loss"]
"""What tells better light from worse: the greater strict window, or the lesser loss."""


class Method(Protocol):
    """A way to find light for a target.

    Attributes:
        papers: Citations of its sources.
        iterations: How many it runs where the caller does not say.
        cost: Projector evaluations that an iteration takes at least.
        criterion: What its best light is chosen by: the strict window for methods that aim at thresholds, the loss for
            methods whose loss is the purpose. With weights or gray bodies it is the loss for all.
        takes_start: Whether it begins with the ``light`` in the memory where there is some; without the attribute it
            does not, and `optimize` refuses a ``start``.
        takes_weights: Whether weights of bodies change its light, as they do wherever ``state.loss`` is lowered;
            without the attribute they do, and where it is False `optimize` refuses them.
    """

    papers: ClassVar[tuple[str, ...]]
    iterations: ClassVar[int]
    cost: ClassVar[float]
    criterion: ClassVar[Criterion]

    def steps(self, state: OptimizerState) -> Steps:
        """Improve ``light`` in the memory for ever, or until nothing is left to gain.

        Every light whose dose is known is offered by ``state.offer``, which keeps the best. Everything a later run
        needs to go on is in ``state.memory`` whenever it yields.

        Args:
            state: Of the run.

        Yields:
            Loss and strict window of the step.
        """
        ...
