"""The emulated screen and camera."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.hosts.emulators.camera import EmulatedCamera, ResinModel, ResinScene, Sensor
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.screen import EmulatedScreen, LitSlot

SECOND = 1_000_000_000


def test_the_screen_lights_slots_one_refresh_later_in_exact_cadence() -> None:
    clock = VirtualClock()
    screen = EmulatedScreen(clock, (2, 3), 60, "GR", 8)
    slots: list[LitSlot] = []
    screen.on_slot = slots.append
    for k in range(3):
        frame = np.zeros((2, 3, 3), np.uint8)
        frame[..., 1], frame[..., 0] = 2 * k + 1, 2 * k + 2
        assert screen.show(frame) == k + 1
    clock.sleep_until(SECOND // 2)
    levels = [int(slot.levels[0, 0]) for slot in slots]
    assert levels[:6] == [1, 2, 3, 4, 5, 6] and set(levels[6:]) == {5, 6}, "a screen repeats what is not replaced"
    assert slots[0].number == 4 and slots[0].start == -(-4 * SECOND // 120)
    assert all(slot.end == after.start for slot, after in zip(slots, slots[1:], strict=False))
    assert screen.repeated > 20


def test_the_camera_is_repeatable_and_the_resin_shows_its_dose() -> None:
    def run(seed: int) -> list[np.ndarray]:
        clock = VirtualClock()
        scene = ResinScene((20, 30), ResinModel(critical=50.0, width=5.0))
        camera = EmulatedCamera(clock, scene, Sensor(bits=12), seed=seed)
        images = []
        for _ in range(11):
            images.append(camera.grab())
            scene.deposit(10.0, 0, SECOND)
        return images

    first, again, other = run(1), run(1), run(2)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])
    means = np.array([image.mean() for image in first]) - 2
    assert (np.diff(means[:8]) > -1).all()
    assert means[-1] / means[0] == pytest.approx(9.0, rel=0.02) and means[5] / means[0] == pytest.approx(5.0, rel=0.02)
    assert first[0].dtype == np.uint16 and first[0].std() > 0
