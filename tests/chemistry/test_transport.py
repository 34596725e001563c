"""Diffusion against the heat kernel, mass and walls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.chemistry.species import SPECIES
from vamgpu.chemistry.transport import FACES, Boundary, Box, Reaction, Transport
from vamgpu.errors import BadInput, ShapeMismatch, UnstableStep
from vamgpu.geometry import centers

PITCH = (0.045, 0.045, 0.067)


def heat_kernel(box: Box, diffusivity: float, time: float) -> np.ndarray:
    """A unit of substance that began as a point on the axis, [1/mm³]."""
    square = np.zeros(box.shape)
    for axis, (n, d) in enumerate(zip(box.shape, box.pitch, strict=True)):
        square = square + np.expand_dims(centers(n, d) ** 2, tuple(k for k in range(3) if k != axis))
    return np.exp(-square / (4 * diffusivity * time)) / (4 * np.pi * diffusivity * time) ** 1.5


def noise(shape: tuple[int, int, int], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(shape)


@pytest.mark.slow
def test_heat_kernel_second_order_over_three_grids(device: Device) -> None:
    diffusivities, begin, span = (0.010, 0.0075, 0.008), 4.0, 1.0
    errors = []
    for level in (1, 2, 4):
        shape = (18 * level, 18 * level, 14 * level)
        pitch = tuple(2.4 * d / level for d in PITCH)
        box = Box(shape, (pitch[0], pitch[1], pitch[2]))
        walk = Transport(box, diffusivities, device=device)
        steps = 6 * level**2
        assert min(diffusivities) * span / steps / pitch[0] ** 2 >= 0.1  # cell Fourier number
        state = walk.start(*(heat_kernel(box, d, begin) for d in diffusivities))
        walk.advance(state, span, steps)
        found = {name: state.species(name).numpy() for name in SPECIES}
        wanted = {n: heat_kernel(box, d, begin + span) for n, d in zip(SPECIES, diffusivities, strict=True)}
        inner = tuple(slice(n // 4, n - n // 4) for n in shape)  # what the faces reflect is no part of the kernel
        errors.append([np.abs(found[n] - wanted[n])[inner].max() / wanted[n].max() for n in ("A", "B")])
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (order > 1.8).all() and np.max(errors[-1]) < 0.01


def test_mass_is_conserved_and_walls_hold(device: Device) -> None:
    box = Box((24, 22, 35), PITCH, radius=0.45)
    walk = Transport(box, (0.002, 0.001, 0.0005), device=device)
    start, inside = noise(box.shape), box.open()
    state = walk.start(start, 2 * start, start)
    walk.advance(state, 40 * walk.limit, 60)
    for name, factor in (("A", 1.0), ("B", 2.0), ("C", 1.0)):
        end = state.species(name).numpy().astype(float)
        assert end[inside].sum() == pytest.approx(factor * start[inside].sum(), rel=1e-5)
        assert np.allclose(end[~inside], factor * start[~inside], atol=1e-6)  # nothing passes the wall
        assert end.min() >= 0 and np.ptp(end[inside]) < np.ptp(factor * start[inside])


def test_no_flux_leaves_an_even_field_as_it_is(device: Device) -> None:
    walk = Transport(Box((9, 8, 21), PITCH), (0.002, 0.001, 0.0005), device=device)
    state = walk.start(0.75, 0.5, 0.25)
    walk.advance(state, 30 * walk.limit)
    for name, value in zip(SPECIES, (0.75, 0.5, 0.25), strict=True):
        assert np.abs(state.species(name).numpy() - value).max() < 1e-6


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_fixed_faces_give_a_straight_profile(device: Device, axis: int) -> None:
    low, high = FACES[2 * axis], FACES[2 * axis + 1]
    faces = [*Boundary.fixed(0.2, low).faces]
    faces[2 * axis + 1] = Boundary.fixed(1.0, high).faces[2 * axis + 1]
    shape = tuple(6 if k == axis else 4 for k in range(3))
    edge = Boundary(tuple(faces))
    box, boundaries = Box((shape[0], shape[1], shape[2]), PITCH), (edge, Boundary(), Boundary())
    walk = Transport(box, (0.002, 0.001, 0.0005), boundaries=boundaries, device=device)
    state = walk.start(0.5, 0.3, 0.0)
    walk.advance(state, 54 * PITCH[axis] ** 2 / 0.002)  # e^−15 of the start is left
    profile = np.moveaxis(state.a.numpy(), axis, 0)
    wanted = 0.2 + 0.8 * (np.arange(6) + 0.5) / 6
    assert np.abs(profile - wanted[:, None, None]).max() < 1e-4
    assert np.abs(state.b.numpy() - 0.3).max() < 1e-6


def test_steps_taken_together_are_the_steps_taken_one_by_one(device: Device) -> None:
    box = Box((70, 9, 37), PITCH, radius=1.4)
    walk = Transport(box, (0.002, 0.001, 0.0005), Reaction(0.9, 0.6, 0.8, 0.2, cross=0.1), device=device)
    light = [device.upload(noise(box.shape, seed)) for seed in (1, 2)]
    together, alone = (walk.start(0.2 * noise(box.shape, 3), 0.1, noise(box.shape, 4)) for _ in range(2))
    step = 0.5 * walk.limit
    walk.advance(together, 7 * step, 7, *light)
    for _ in range(7):
        walk.advance(alone, step, 1, *light)
    one, other = together.numpy(), alone.numpy()
    for name in ("a", "b", "c", "dose"):
        assert np.abs(one[name] - other[name]).max() <= 2e-6 * max(np.abs(other[name]).max(), 1e-6), name
    assert one["dose"].max() > 0


def test_oxygen_alone_follows_equation_12(device: Device) -> None:
    """dc/dt = ∇²c + Da of the share that is gone, c = ([A]₀ − [A])/[A]₀, marched here by itself."""
    shape, length, span, steps = (6, 5, 7), 0.067, 0.2, 8
    box = Box(shape, (length, length, length))
    walk = Transport(box, (3.27e-4, 1e-6, 1e-6), Reaction(0.02, 0.0, 0.0, 0.0), device=device)
    light, first = noise(shape, 5), 1.2
    da = length**2 * 0.02 * light / (first * 3.27e-4)
    gone = np.zeros(shape)
    for _ in range(steps):
        padded = np.pad(gone, 1, mode="edge")
        near = sum(np.roll(padded, turn, axis)[1:-1, 1:-1, 1:-1] - gone for axis in range(3) for turn in (1, -1))
        gone = gone + span / steps * (near + da)
    state = walk.start(first, 0.0, 0.0)
    walk.advance(state, span * length**2 / 3.27e-4, steps, device.upload(light))
    assert np.abs(1.0 - state.a.numpy() / first - gone).max() < 3e-5 * gone.max()


def test_bad_input_is_refused_with_the_limit_it_broke(device: Device) -> None:
    box = Box((4, 4, 4), PITCH)
    walk = Transport(box, (1e-3, 1e-3, 1e-3), device=device)
    assert walk.limit == pytest.approx(1 / (1e-3 * 2 * (2 / 0.045**2 + 1 / 0.067**2)))
    with pytest.raises(UnstableStep, match="not stable") as caught:
        walk.advance(walk.start(1.0), 3 * walk.limit, 1)
    assert caught.value.limit == walk.limit
    for wrong in ((0.0, 1e-3, 1e-3), (1e-3, -1.0, 1e-3), (1e-3, 1e-3, float("nan"))):
        with pytest.raises(BadInput, match="diffusivity"):
            Transport(box, wrong, device=device)
    with pytest.raises(BadInput, match="A. is -0.1 at its lowest"):
        walk.start(-0.1)
    with pytest.raises(BadInput):
        walk.start(np.full(box.shape, np.nan))
    with pytest.raises(ShapeMismatch):
        walk.start(np.zeros((3, 4, 4)))
    with pytest.raises(BadInput, match="no species is named 'D'"):
        walk.start().species("D")
    with pytest.raises(BadInput, match="no face"):
        Boundary.fixed(1.0, "top")
    with pytest.raises(BadInput, match="faces is -1.0; expected a finite number"):
        Boundary.fixed(-1.0, "z high")
    with pytest.raises(BadInput, match="order"):
        Reaction(1.0, 1.0, 1.0, 1.0, order=2)
    with pytest.raises(BadInput, match="three edges"):
        Box((4, 4, 4), 0.1)  # type: ignore[arg-type]


def still(box: Any, diffusivities: Any = (1e-3, 1e-3, 1e-3), **rest: Any) -> Any:
    return Transport(box, diffusivities, device=rest.pop("device", "numpy"), **rest)


@pytest.mark.parametrize(("make", "told"), [
    (lambda box: still((4, 4, 4)), "expected a Box"),
    (lambda box: still(box, 1e-3), "one for each of A, B, C"),
    (lambda box: still(box, boundaries=Boundary()), "one for each of A, B, C"),
    (lambda box: still(box, boundaries=(1, 2, 3)), "expected a Boundary"),
    (lambda box: still(box, reaction="fast"), "expected a Reaction"),
    (lambda box: still(box).start("much"), r"\[A\] is 'much'; expected finite numbers"),
    (lambda box: still(box).advance(None, 1.0), "expected Concentrations"),
    (lambda box: Boundary(1), "expected six"),  # type: ignore[arg-type]
])  # fmt: skip
def test_what_is_no_number_and_no_box_is_named(make: Callable[[Box], object], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        make(Box((4, 4, 4), PITCH))
