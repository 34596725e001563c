"""Which scenarios a run computes: those that hold the window, and all of them every so often."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.reductions import extent, window
from vamgpu.operators.scenarios import Scenarios

OFTEN = 10
"""Steps from one look at all scenarios to the next."""
SLACK = 1e-3
"""Dose, a share of the greatest, by which a scenario that rests may be beyond all others before it is computed."""

TIED = 2e-3
"""Dose, a share of the greatest, by which scenarios hold a window of thresholds alike."""


class ActiveScenarios:
    """The scenarios of a run: it begins with those that hold the first light's window, and takes up others that do.

    The limits of one that rests have no price, so that light and bound of the others are those of all as long as its
    dose lies between theirs. One rests again once it has no price left. While any rests, a step's window is that of the
    others: only a look at all tells the light's own.

    Args:
        state: Of the run; a resumed one goes on with the scenarios that its memory names.
        void: Dose outside the part that stands for that of scenarios that rest; in the part it is 1.
    """

    scenarios: Scenarios | None
    state: OptimizerState
    void: float

    def __init__(self, state: OptimizerState, void: float = -1.0) -> None:
        operator, self.void = state.operator, void
        self.scenarios = operator if isinstance(operator, Scenarios) and len(operator) > 1 else None
        self.state = state
        if self.scenarios is not None and "resting" in state.memory:
            self._rest(tuple(map(bool, state.memory["resting"])))

    @property
    def any_rest(self) -> bool:
        """Whether the last step knew less than the whole dose."""
        return self.scenarios is not None and any(self.scenarios.resting)

    @property
    def due(self) -> bool:
        """Whether the iteration in progress is one that looks at all scenarios."""
        return self.scenarios is not None and self.state.iteration % OFTEN == OFTEN - 1

    @contextmanager
    def awake(self) -> Iterator[None]:
        """Inside, no scenario rests."""
        before = self.scenarios.resting if self.scenarios is not None else ()
        if any(before):
            self._rest((False,) * len(before))
        yield
        if any(before):
            self._rest(before)

    def begin(self, held: DeviceArray) -> None:
        """Choose the first scenarios.

        Args:
            held: Dose of the first light at all of them.
        """
        if self.scenarios is not None:
            holding = _holding(self._windows(held))
            self._rest(tuple(s not in holding for s in range(len(self.scenarios))))

    def look(self, fields: Mapping[str, DeviceArray]) -> bool:
        """Compute the dose at all scenarios, half an evaluation each, and choose those that hold the window.

        Args:
            fields: Light, dose (replaced where any rested), and prices.

        Returns:
            Whether others rest than before.
        """
        scenarios, state = self.scenarios, self.state
        if scenarios is None:
            return False
        before = scenarios.resting
        if any(before):
            self._rest((False,) * len(before))
            state.expose(fields["light"], fields["held"])
        found = self._windows(fields["held"])
        holding = _holding(found)
        known = [one for one, rests in zip(found, before, strict=True) if not rests]
        low, high, top = (pick(one[k] for one in known) for k, pick in enumerate((min, max, max)))
        chosen = []
        for scenario, (rests, (least, leak, greatest)) in enumerate(zip(before, found, strict=True)):
            beyond = least < low - SLACK or leak > high + SLACK or greatest > max(top, 1.0) + SLACK
            if rests:
                chosen.append(not (scenario in holding and beyond))
            else:
                chosen.append(scenario not in holding and not self._priced(scenario, fields))
        self._rest(tuple(chosen))
        return tuple(chosen) != before

    def hold(self, light: DeviceArray, dose: DeviceArray) -> float:
        """Compute the dose at all scenarios, half an evaluation each, and let those rest that do not hold the window.

        Args:
            light: [angle, r, z].
            dose: Takes its dose at all of them.

        Returns:
            The light's strict window, all scenarios counted.
        """
        scenarios, state = self.scenarios, self.state
        assert scenarios is not None
        if self.any_rest:
            self._rest((False,) * len(scenarios))
        state.expose(light, dose)
        found = self._windows(dose)
        holding, greatest = _holding(found), max(top for _, _, top in found)
        low, high = min(least for least, _, _ in found), max(leak for _, leak, _ in found)
        for scenario, (least, leak, _) in enumerate(found):
            if least < low + TIED * greatest or leak > high - TIED * greatest:
                holding.add(scenario)
        self._rest(tuple(scenario not in holding for scenario in range(len(scenarios))))
        return state.window(dose)[0]

    def counted(self, fields: np.ndarray) -> np.ndarray:
        """What does not rest of a volume of all scenarios, 0 elsewhere.

        Args:
            fields: [x, y, scenario · z].

        Returns:
            The same shape.
        """
        if self.scenarios is None:
            return fields
        working = np.repeat(~np.array(self.scenarios.resting), self.scenarios.each.shape[2])
        return fields * working.astype(fields.dtype)

    def _windows(self, held: DeviceArray) -> list[tuple[float, float, float]]:
        assert self.scenarios is not None
        pairs = [
            [self.scenarios.taken(field, s) for field in (held, self.state.target)] for s in range(len(self.scenarios))
        ]
        return [window(dose, target, self.state.reach) for dose, target in pairs]

    def _priced(self, scenario: int, fields: Mapping[str, DeviceArray]) -> bool:
        assert self.scenarios is not None
        return any(extent(self.scenarios.taken(fields[name], scenario))[1] > 0.0 for name in ("wall", "cap"))

    def _rest(self, resting: tuple[bool, ...]) -> None:
        scenarios = self.scenarios
        assert scenarios is not None
        instead = None
        if any(resting):
            part = scenarios.taken(self.state.target, 0).numpy() >= 0.5
            instead = scenarios.device.upload(np.where(part, 1.0, self.void).astype(np.float32))
        scenarios.rest(resting, instead)
        self.state.memory["resting"] = resting


def _holding(found: list[tuple[float, float, float]]) -> set[int]:
    """Scenarios of the least dose inside, the greatest outside, and the greatest anywhere."""
    least, leak, greatest = (np.array(values) for values in zip(*found, strict=True))
    return {int(np.argmin(least)), int(np.argmax(leak)), int(np.argmax(greatest))}
