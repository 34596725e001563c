"""What every method is: a frozen choice of parameters and a generator of steps."""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, ClassVar, Protocol

if TYPE_CHECKING:
    from vamgpu.optimize.work import Work


Steps = Generator[tuple[float, float], None, None]
"""Loss and strict window after every step."""


class Method(Protocol):
    """A way to find light for a target.

    papers: citations of its sources.  iterations: how many it runs where the caller does not say.
    """

    papers: ClassVar[tuple[str, ...]]
    iterations: ClassVar[int]

    def steps(self, work: Work) -> Steps:
        """Improve ``work.light`` for ever, or until nothing is left to gain: (loss, strict window) after every step.

        Everything a later run needs to go on is in ``work.memory`` whenever it yields.
        """
        ...
