"""Projectors that are screens: the slots that frames are lit in."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.projector import THREE_OF_7, TWO_OF_8, HdmiProjector, Window
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.screen import EmulatedScreen, LitSlot

SECOND = 1_000_000_000


def test_the_projector_lights_frames_in_the_slots_it_says() -> None:
    clock = VirtualClock()
    for layout, order, bits in ((TWO_OF_8, "GR", 8), (THREE_OF_7, "GRB", 7)):
        screen = EmulatedScreen(clock, (4, 5), 60, order, bits)
        slots: dict[int, LitSlot] = {}
        screen.on_slot = lambda slot, slots=slots: slots.update({slot.number: slot})
        assert isinstance(screen, Window)
        projector = HdmiProjector(screen, layout)
        assert projector.slots_per_s == 60 * layout.slots
        rng, sent = np.random.default_rng(2), {}
        for _ in range(5):
            frames = list(rng.integers(0, 256, (layout.slots, 4, 5), dtype=np.uint8))
            first = projector.show(frames)
            sent |= {first + i: frame for i, frame in enumerate(frames)}
        clock.sleep(SECOND)
        for number, frame in sent.items():
            found = slots[number].levels / slots[number].top
            assert np.abs(found - frame / 255).max() <= (0 if bits == 8 else 0.5 / 127) + 1e-9
        with pytest.raises(BadInput, match="4 x 5"):
            projector.show([np.zeros((4, 4), np.uint8)] * layout.slots)
        projector.close()
