"""Band constraint Lp norm minimization with the choices of the roll-to-roll paper, its loss computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu import Beam, Grid, Projection, Turntable
from vamgpu.backend.device import Device
from vamgpu.methods import BCLP, Logistic
from vamgpu.methods.state import OptimizerState

N = 12


def test_the_papers_choices_are_its_numbers() -> None:
    method = BCLP.paper_002()
    assert (method.p, method.slack, method.penalty, method.ridge) == (3.0, (0.05, 0.01), (1.0, 1.0), 0.04)
    assert method.momentum == 0.5 and method.q in (None, 3.0)
    assert method.response == Logistic(10.0, 0.5)


@pytest.mark.parametrize("fractional", [False, True])
def test_the_loss_is_the_papers_sum(device: Device, fractional: bool) -> None:
    """Σ max(0, |M − f| − ε)³ + 0.04·Σ M² over the cylinder, M logistic in the dose; and its slope by dose."""
    operator = Projection(Grid((N, N, N), 0.25), Beam((N, N), 0.25), Turntable(8), device=device)
    rng = np.random.default_rng(3)
    target = rng.random((N, N, N)) if fractional else (rng.random((N, N, N)) > 0.6).astype(float)
    dose = rng.random((N, N, N)) * 1.2
    state = OptimizerState(operator, device.upload(target), {})
    field = device.upload(dose)
    found = state.loss(field, BCLP.paper_002().band())

    place = np.arange(N) - 0.5 * (N - 1)
    near = (np.hypot(place[:, None], place) <= state.reach)[:, :, None]
    made = 1.0 / (1.0 + np.exp(-10.0 * (dose - 0.5)))
    slack = 0.05 + (0.01 - 0.05) * target
    excess = np.maximum(0.0, np.abs(made - target) - slack)
    assert found == pytest.approx(float(np.sum((excess**3 + 0.04 * made**2) * near)), rel=1e-4)
    slope = (3.0 * excess**2 * np.sign(made - target) + 2.0 * 0.04 * made) * 10.0 * made * (1.0 - made) * near
    apart = np.abs(field.numpy() - slope)
    assert apart.max() < 0.02 * np.abs(slope).max()  # the response is a line between its samples
