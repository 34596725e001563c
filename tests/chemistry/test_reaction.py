"""The reactions of a voxel against an ordinary integrator, and what happens as inhibitors run out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vamgpu.backend.device import Device
from vamgpu.chemistry.concentrations import NEVER, Concentrations
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import LightCycle, Rates
from vamgpu.chemistry.transport import Box, Reaction, Transport

BOX = Box((2, 2, 5), (1.0, 1.0, 1.0))
VISIBLE, ULTRAVIOLET = 1.3, 0.4


def advanced(
    device: Device, reaction: Reaction, span: float, steps: int, start: tuple[float, float, float],
    light: tuple[float, float] = (VISIBLE, ULTRAVIOLET),
) -> Concentrations:  # fmt: skip
    walk = Transport(BOX, (1e-6, 1e-6, 1e-6), reaction, device=device)
    state = walk.start(*start)
    fields = [device.upload(np.full(BOX.shape, value)) for value in light]
    walk.advance(state, span, steps, *fields)
    return state


def voxel(state: Concentrations) -> np.ndarray:
    return np.array([state.species(name).numpy()[0, 0, 0] for name in "ABC"])


@pytest.mark.parametrize("order", [0, 1])
def test_rates_are_those_of_equations_5_to_7(device: Device, order: int) -> None:
    k = Reaction(0.05, 0.03, 0.06, 0.2, initial=2.0, order=order)

    def rates(_: float, y: np.ndarray) -> list[float]:
        a, b, c = y
        split = k.k_c * ULTRAVIOLET * (c / k.initial if order else 1.0)
        paired = k.k_2 * b * b
        return [
            -k.k_a * VISIBLE * a / (a + b),
            -k.k_b * VISIBLE * b / (a + b) + 2 * split - 2 * paired,
            paired - split,
        ]

    wanted = solve_ivp(rates, (0.0, 10.0), [1.0, 0.0, 2.0], rtol=1e-10, atol=1e-12).y[:, -1]
    errors = [np.abs(voxel(advanced(device, k, 10.0, n, (1.0, 0.0, 2.0))) - wanted).max() for n in (100, 200, 400)]
    assert errors[-1] < 1e-3 and errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("order", [0, 1])
def test_without_diffusion_a_voxel_of_transport_follows_the_kinetics(device: Device, order: int) -> None:
    """Two solvers, one set of rates: `Reaction.of` must mean what `advance` makes of `Rates`, [A]₀ and [C]₀ not 1."""
    rates = Rates(0.05, 0.03, 0.06, 0.2, oxygen=0.8, supply=2.0, order=order)
    course = advance(rates, rates.start(0.1), LightCycle(VISIBLE, ULTRAVIOLET, 10.0), tolerance=1e-10, device="numpy")
    wanted = np.array([course.a[0, 0], course.b[0, 0], course.c[0, 0]])
    start = (0.8, 0.1, 2.0)
    coarse, fine = (voxel(advanced(device, Reaction.of(rates), 10.0, n, start)) for n in (200, 400))
    assert np.abs(fine - wanted).max() < 1e-3
    assert np.abs(2.0 * fine - coarse - wanted).max() < 2e-5  # the step's first order taken away


@pytest.mark.slow
@pytest.mark.parametrize("order", [0, 1])
def test_transport_and_kinetics_run_out_of_inhibitor_together(device: Device, order: int) -> None:
    rates = Rates(0.05, 0.03, 0.01, 0.2, oxygen=0.8, supply=2.0, order=order)
    course = advance(rates, rates.start(0.1), LightCycle(VISIBLE, ULTRAVIOLET, 30.0), tolerance=1e-10, device="numpy")
    reaction = Reaction.of(rates, optical=1e-4, mechanical=2e-4)
    state = advanced(device, reaction, 30.0, 3000, (0.8, 0.1, 2.0))
    assert 10.0 < course.event[0, 0] < 25.0
    assert state.optical_time.numpy() == pytest.approx(course.event[0, 0], abs=0.01)  # a step


def test_what_visible_light_takes_is_all_that_leaves_the_balance(device: Device) -> None:
    """[A]/k_A + ([B] + 2[C])/k_B falls by the light that inhibitors took; what is left over is the dose."""
    k = Reaction(0.3, 0.2, 0.1, 0.5, initial=1.0)
    state = advanced(device, k, 40.0, 800, (1.0, 0.1, 0.6), light=(0.4, 0.2))
    a, b, c = voxel(state)
    taken = (1.0 - a) / k.k_a + (0.1 + 1.2 - b - 2 * c) / k.k_b
    dose = state.dose.numpy()[0, 0, 0]
    assert dose > 0.1
    assert taken + dose == pytest.approx(0.4 * 40.0, rel=2e-5)


def test_nothing_polymerizes_before_the_inhibitors_are_gone(device: Device) -> None:
    k = Reaction(0.1, 0.1, 0.0, 0.0, optical=2.0, mechanical=5.0)
    # A lasts 1 / (k_a·I) = 10 s at 1 mW/mm²; then 2 and 5 mJ/mm² take 2 s and 5 s more
    early = advanced(device, k, 9.9, 99, (1.0, 0.0, 0.0), light=(1.0, 0.0))
    assert not early.dose.numpy().any() and (early.optical_time.numpy() == NEVER).all()
    late = advanced(device, k, 20.0, 200, (1.0, 0.0, 0.0), light=(1.0, 0.0))
    assert late.dose.numpy() == pytest.approx(10.0, rel=1e-4)
    assert late.optical_time.numpy() == pytest.approx(12.0, rel=1e-4)
    assert late.mechanical_time.numpy() == pytest.approx(15.0, rel=1e-4)
    assert not late.a.numpy().any()


@pytest.mark.slow
def test_ultraviolet_inhibits_while_there_is_c_and_cures_once_it_is_gone(device: Device) -> None:
    k = Reaction(0.1, 0.1, 0.4, 0.0, initial=1.0, cross=0.2)
    kept = advanced(device, k, 6.0, 300, (1.0, 0.0, 1.0), light=(0.2, 1.0))
    assert kept.b.numpy().min() > 1.0 and not kept.dose.numpy().any()  # UV makes more than the light takes
    gone = advanced(device, k, 150.0, 1500, (1.0, 0.0, 1.0), light=(0.2, 1.0))
    without = advanced(device, k, 150.0, 1500, (1.0, 0.0, 1.0), light=(0.2, 0.0))
    assert gone.c.numpy().max() < 1e-3 and gone.a.numpy().max() == 0.0
    # with no cross-reactivity 3 mol/m³ of inhibitor would last 30 mJ/mm² of visible light: all of what is shown
    static = advanced(device, Reaction(0.1, 0.1, 0.4, 0.0, initial=1.0), 150.0, 1500, (1.0, 0.0, 1.0), light=(0.2, 1.0))
    assert static.dose.numpy().max() < 1e-2
    assert gone.dose.numpy().min() == pytest.approx(0.4 * 150.0 - 30.0, rel=1e-3)
    assert without.dose.numpy().min() == pytest.approx(0.2 * 150.0 - 10.0, rel=1e-3)


def test_species_stay_at_or_above_zero_whatever_the_step(device: Device) -> None:
    k = Reaction(5.0, 3.0, 4.0, 9.0, order=0)
    state = advanced(device, k, 6.0, 3, (0.3, 0.2, 0.4))
    assert voxel(state).min() >= 0.0
