"""Frames: bytes to light, by the book, on every device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import Placement

CURVE = GrayCurve((0, 100, 255), (0.02, 0.3, 1.0))
ANGLES, ROWS, COLUMNS = 5, 19, 13


def random_bytes(bits: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    if bits == 8:
        return rng.integers(0, 256, (ANGLES, ROWS, COLUMNS), np.uint8)
    return np.packbits(rng.integers(0, 2, (ANGLES, ROWS, COLUMNS), np.uint8), axis=-1)


def frames_of(device: Device | str, bits: int, **fields: object) -> Frames:
    known = {"gray": CURVE, "scale": 3.0, "columns": COLUMNS} | fields
    return Frames.from_bytes(random_bytes(bits), device, bits=bits, **known)


def by_hand(frames: Frames) -> np.ndarray:
    """Light [angle, r, z] of every pixel, one after the other."""
    levels, settings = frames.levels(), frames.settings
    light = np.zeros((ANGLES, COLUMNS, ROWS))
    dr, dz = settings.shift
    for row in range(ROWS):
        for column in range(COLUMNS):
            gray = frames.gray(levels[:, row, column] * (1 if frames.bits == 8 else 255))
            shown = frames.scale * gray * (1.0 if frames.flat_field is None else frames.flat_field[row, column])
            r = (COLUMNS - 1 - column if settings.flip_r else column) - dr
            z = (row if settings.flip_z else ROWS - 1 - row) - dz
            for beam_r in range(COLUMNS):
                for beam_z in range(ROWS):
                    share = max(0.0, 1.0 - abs(beam_r - r)) * max(0.0, 1.0 - abs(beam_z - z))
                    light[:, beam_r, beam_z] += share * shown
    return light


@pytest.mark.parametrize("bits", [8, 1])
@pytest.mark.parametrize(
    "settings",
    [
        Placement(),
        Placement(flip_r=True),
        Placement(flip_z=True, shift=(2.0, -3.0)),
        Placement(flip_r=True, flip_z=True, shift=(-0.3, 1.75)),
    ],
)
def test_light_is_that_of_every_pixel_where_it_lands(device: Device, bits: int, settings: Placement) -> None:
    flat = 0.5 + np.random.default_rng(4).random((ROWS, COLUMNS))
    frames = frames_of(device, bits, settings=settings, flat_field=flat)
    wanted = by_hand(frames)
    light = frames.irradiance()
    assert light.device is device and light.shape == (ANGLES, COLUMNS, ROWS)
    assert np.abs(light.numpy() - wanted).max() <= 1e-5 * wanted.max()


@pytest.mark.parametrize("bits", [8, 1])
def test_black_frames_still_shine(device: Device, bits: int) -> None:
    black = np.zeros_like(random_bytes(bits))
    frames = Frames.from_bytes(black, device, bits=bits, gray=CURVE, scale=3.0, columns=COLUMNS)
    assert np.allclose(frames.irradiance().numpy(), 3.0 * 0.02, rtol=1e-6)


@pytest.mark.parametrize("bits", [8, 1])
def test_one_bit_changes_the_light_of_exactly_one_pixel(device: Device, bits: int) -> None:
    frames = frames_of(device, bits)
    content = random_bytes(bits)
    before = frames.irradiance().numpy()
    byte, place = (7, 0b10000000) if bits == 8 else (1, 0b01000000)  # column 7, or column 8 + 1
    content[2, 4, byte] ^= place
    after = Frames.from_bytes(content, device, bits=bits, gray=CURVE, scale=3.0, columns=COLUMNS).irradiance().numpy()
    changed = np.argwhere(before != after)
    assert changed.tolist() == [[2, 7 if bits == 8 else 9, ROWS - 1 - 4]]


def test_frames_move_between_devices_with_their_bytes(device: Device) -> None:
    there = open_device("numpy" if device.name != "numpy" else "warp:cpu")
    frames = frames_of(device, 1)
    moved = frames.on(there)
    assert moved.device is there and np.array_equal(moved.levels(), frames.levels())
    assert frames.on(device) is frames
    assert np.allclose(frames.irradiance(there).numpy(), frames.irradiance().numpy(), rtol=1e-6)


def test_viewers_get_full_gray_levels() -> None:
    with pytest.warns(DeprecationWarning, match="Frames.pictures is called gray_levels"):
        assert frames_of("numpy", 1).pictures().max() == 255
    assert set(np.unique(frames_of("numpy", 1).gray_levels())) == {0, 255}
    assert frames_of("numpy", 8).gray_levels().shape == frames_of("numpy", 1).shape == (ANGLES, ROWS, COLUMNS)


def test_bad_frames_are_refused() -> None:
    frames = frames_of("numpy", 8)
    for change, error, says in (
        ({"bits": 4}, BadInput, "1 or 8"),
        ({"scale": 0.0}, BadInput, "scale"),
        ({"scale": float("nan")}, BadInput, "scale"),
        ({"columns": COLUMNS + 1}, ShapeMismatch, "row, 14"),
        ({"bits": 1}, ShapeMismatch, "1 bits"),
        ({"flat_field": np.ones((COLUMNS, ROWS))}, ShapeMismatch, r"\[row, column\]"),
        ({"flat_field": np.zeros((ROWS, COLUMNS))}, BadInput, "dead mirrors"),
    ):
        with pytest.raises(error, match=says):
            replace(frames, **change)
    with pytest.raises(BadInput, match="uint8"):
        Frames.from_bytes(np.zeros((1, 2, 3)), "numpy", bits=8, gray=CURVE, scale=1.0, columns=3)


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"shift": (1.0,)}, "two numbers"),
        ({"shift": (float("inf"), 0.0)}, "finite"),
        ({"shift": "left"}, "two numbers"),
        ({"flip_r": 1}, "True or False"),
        ({"quantile": 0.0}, "0 < quantile"),
        ({"quantile": float("nan")}, "0 < quantile"),
        ({"dither": "blue"}, "error-diffusion"),
    ],
)
def test_bad_settings_are_refused(fields: dict, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        Placement(**fields)
