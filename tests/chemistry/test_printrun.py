"""Light through what is left of C, turned frame by frame; and prints broken off and taken up again."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.chemistry.exposure import ColorExposure, ColorExtinction
from vamgpu.chemistry.printrun import PrintRun
from vamgpu.chemistry.transport import Box, Reaction, Transport
from vamgpu.errors import BadInput, ShapeMismatch, UnstableStep
from vamgpu.geometry import Turntable, centers

BOX = Box((33, 33, 5), (0.1, 0.1, 0.15), radius=1.6)
RESIN = Reaction(0.05, 0.04, 0.08, 0.05, initial=2.0, cross=0.05, optical=1.0, mechanical=2.0)
COLORS = (ColorExtinction(0.1, 0.05), ColorExtinction(0.2, 0.3))


def print_of(device: Device, angles: int = 24, turns: int = 2, box: Box = BOX, half: bool = False) -> PrintRun:
    r = centers(box.shape[0], box.pitch[0])
    visible = np.broadcast_to((np.abs(r) < 1.2)[None, :, None] * 1.0, (angles, len(r), box.shape[2]))
    ultraviolet = np.broadcast_to((np.abs(r) > 0.6)[None, :, None] * 0.7, visible.shape)
    if half:  # only half of the turn is lit
        visible = visible * (np.arange(angles) < angles // 2)[:, None, None]
    exposure = ColorExposure(box, visible, ultraviolet, COLORS, device=device)
    return PrintRun(Transport(box, (1e-4, 3e-5, 3e-5), RESIN, device=device), exposure, 12.0, turns)


def test_light_of_a_pose_is_beer_lambert_through_an_even_resin(device: Device) -> None:
    job = print_of(device)
    inside = BOX.open()
    x, y = (centers(n, d) for n, d in zip(BOX.shape[:2], BOX.pitch, strict=False))
    flat = ColorExposure(BOX, np.ones((24, 33, 5)), np.full((24, 33, 5), 2.0), COLORS, device=device)
    c = device.upload(np.full(BOX.shape, 1.7))
    for angle in (0, 5, 13):
        turn = 2 * np.pi * angle / 24
        r = y[None] * np.cos(turn) - x[:, None] * np.sin(turn)
        s = -(x[:, None] * np.cos(turn) + y[None] * np.sin(turn))
        length = np.sqrt(np.maximum(1.6**2 - r**2, 0.0)) + s
        for found, power, color in zip(flat.irradiance(c, angle), (1.0, 2.0), COLORS, strict=True):
            wanted = power * np.exp(-(color.constant + 1.7 * color.per_c) * length)
            apart = np.abs(found.numpy()[..., 2] - wanted)
            core = x[:, None] ** 2 + y[None] ** 2 < 1.45**2  # beside the wall chords end between two rays
            assert apart[core].max() < 0.005 * power
            assert apart[inside].mean() < 0.002 * power
            assert not found.numpy()[~inside].any()
    assert job.frames == 48


def test_light_comes_from_where_the_angles_were_measured(device: Device) -> None:
    light, c = np.random.default_rng(2).random((24, 33, 5)), device.upload(np.full(BOX.shape, 1.7))
    turned = Turntable(np.roll(Turntable(24).poses, -7))
    even, measured = (
        ColorExposure(BOX, light, None, COLORS, device=device, motion=motion) for motion in (None, turned)
    )
    rolled = ColorExposure(BOX, np.roll(light, 7, axis=0), None, COLORS, device=device)
    shown = measured.irradiance(c, 3)[0].numpy()
    assert np.array_equal(shown, rolled.irradiance(c, 10)[0].numpy())
    assert np.abs(shown - even.irradiance(c, 3)[0].numpy()).max() > 0.1
    for motion in (Turntable(23), Turntable(24, dwell=np.linspace(1, 2, 24))):
        with pytest.raises(BadInput, match="expected as many angles, lit for equal times"):
            ColorExposure(BOX, light, None, COLORS, device=device, motion=motion)


def test_light_goes_through_the_c_there_is(device: Device) -> None:
    """C that varies from place to place, against fine quadrature along the same rays."""

    def amount(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1.5 + np.sin(1.7 * x + 0.4) * np.cos(1.3 * y)

    errors = []
    for n in (17, 33, 65):
        box = Box((n, n, 4), (3.3 / n, 3.3 / n, 0.2), radius=1.6)
        x, y = (centers(n, 3.3 / n) for _ in range(2))
        c = device.upload(np.broadcast_to(amount(x[:, None], y[None])[..., None], box.shape))
        exposure = ColorExposure(box, None, np.ones((10, n, 4)), COLORS, device=device)
        found = exposure.irradiance(c, 3)[1].numpy()[..., 1]
        turn = 2 * np.pi * 0.3
        r = y[None] * np.cos(turn) - x[:, None] * np.sin(turn)
        s = -(x[:, None] * np.cos(turn) + y[None] * np.sin(turn))
        entry = -np.sqrt(np.maximum(1.6**2 - r**2, 0.0))
        share = (np.arange(400) + 0.5) / 400
        along = entry[..., None] + (s - entry)[..., None] * share
        px = -r[..., None] * np.sin(turn) - along * np.cos(turn)
        py = r[..., None] * np.cos(turn) - along * np.sin(turn)
        wanted = np.exp(-0.2 * (s - entry) - 0.3 * amount(px, py).mean(-1) * (s - entry))
        errors.append(np.abs(found - wanted)[x[:, None] ** 2 + y[None] ** 2 < 1.3**2].max())
    assert errors[2] < 1e-3 and errors[0] / errors[2] > 6.0


def test_extinction_follows_the_depletion_of_c(device: Device) -> None:
    job = print_of(device, turns=8)
    state, ray = job.transport.start(1.0, 0.0, 2.0), (6, 24, 2)  # a voxel that is far from the source, in UV's ring

    def there() -> float:
        return float(job.exposure.irradiance(state.c, 0)[1].numpy()[ray])

    fresh = there()
    job.run(state)
    c = state.c.numpy()
    assert fresh > 0 and there() > 1.02 * fresh
    assert c[16, 16, 2] == pytest.approx(2.0, rel=1e-3) and c[6, 24, 2] < 1.7  # the axis lies in the shadow of both


def test_every_frame_shows_the_light_of_its_pose(device: Device) -> None:
    """Light at one pose of four alone: oxygen falls in that frame of each turn, and in no other."""
    visible = np.zeros((4, 33, 5))
    visible[1] = 1.0
    exposure = ColorExposure(BOX, visible, None, COLORS, device=device)
    job = PrintRun(Transport(BOX, (1e-6, 1e-6, 1e-6), RESIN, device=device), exposure, 12.0, 2)
    state, held = job.transport.start(1.0, 0.0, 2.0), [1.0]
    job.run(state, progress=lambda frame, now: held.append(float(now.a.numpy()[16, 16, 2])))
    assert [bool(fall > 0.01) for fall in -np.diff(held)] == [False, True, False, False] * 2


def ripple(device: Device, angles: int, place: tuple[int, int]) -> np.ndarray:
    """Concentration of A in a voxel through the second turn of an even print of visible light."""
    flat = np.ones((angles, 33, 5))
    exposure = ColorExposure(BOX, flat, None, (ColorExtinction(0.6), ColorExtinction()), device=device)
    job = PrintRun(Transport(BOX, (1e-6, 1e-6, 1e-6), RESIN, device=device), exposure, 12.0, 2)
    state, seen = job.transport.start(1.0, 0.0, 2.0), []
    job.run(state, progress=lambda frame, now: seen.append(float(now.a.numpy()[(*place, 2)])))
    return np.array(seen[angles - 1 :])


def test_the_rim_feels_the_rotation_and_the_axis_does_not(fast_device: Device) -> None:
    def unevenness(place: tuple[int, int]) -> float:
        a = ripple(fast_device, 36, place)
        return float(np.abs(a - np.linspace(a[0], a[-1], len(a))).max() / (a[0] - a[-1]))

    rim, axis = unevenness((31, 16)), unevenness((16, 16))
    assert rim > 0.1 and axis < 0.01 and rim > 20 * axis


def test_more_angles_a_turn_converge(fast_device: Device) -> None:
    def end(angles: int) -> np.ndarray:
        job = print_of(fast_device, angles, half=True)
        state = job.transport.start(1.0, 0.0, 2.0)
        job.run(state)
        return state.a.numpy()[BOX.open()].astype(float)

    fine = end(288)
    errors = [np.abs(end(angles) - fine).mean() for angles in (12, 24, 48, 96)]
    assert errors[0] > 1.4 * errors[1] > 1.4 * 1.4 * errors[2] > 1.4**3 * errors[3]
    assert errors[3] < 0.1 * errors[0]


def test_a_print_taken_up_again_ends_as_the_one_that_ran_through(device: Device) -> None:
    job = print_of(device, angles=8)
    whole = job.transport.start(1.0, 0.0, 2.0)
    assert job.run(whole) == 16
    state = job.transport.start(1.0, 0.0, 2.0)
    assert job.run(state, until=11) == 11 and state.time == pytest.approx(11 * job.frame_time)
    assert print_of(device, angles=8).run(state, 11) == 16
    for name, values in whole.numpy().items():
        assert np.array_equal(values, state.numpy()[name]), name


def test_bad_prints_are_refused(device: Device) -> None:
    job = print_of(device, angles=8)
    with pytest.raises(UnstableStep):
        fast = Transport(BOX, (0.1, 0.1, 0.1), RESIN, device=device)
        PrintRun(fast, job.exposure, 12.0, 1, steps=1)
    with pytest.raises(BadInput, match="reaction"):
        PrintRun(Transport(BOX, (0.1, 0.1, 0.1), device=device), job.exposure, 12.0, 1)
    with pytest.raises(BadInput, match="light holds"):
        ColorExposure(BOX, -np.ones((8, 33, 5)), None, device=device)
    with pytest.raises(ShapeMismatch):
        ColorExposure(BOX, np.ones((8, 33, 4)), None, device=device)
    with pytest.raises(BadInput, match="radius"):
        ColorExposure(Box((33, 33, 5), (0.1, 0.1, 0.1)), np.ones((8, 33, 5)), None, device=device)
    with pytest.raises(BadInput, match="per_c"):
        ColorExtinction(0.0, -1.0)
