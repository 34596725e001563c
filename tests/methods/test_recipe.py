"""The recipe of automatic exposure by hand: background, ramp, clip, normalize, correct by the ratio, once more."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu import Beam, Grid, Projection, Turntable
from vamgpu.methods import Recipe, optimize
from vamgpu.methods.ramp import ramp
from vamgpu.methods.state import OptimizerState

N, NZ = 20, 4


@pytest.mark.parametrize(("background", "passes"), [(0.6, 1), (0.6, 2), (0.3, 2)])
def test_passes_are_those_of_the_paper(background: float, passes: int) -> None:
    """Over 60 % the model of the first pass is 0.6 + 0.4·f; the next is that times wanted over got, at most tenfold."""
    operator = Projection(Grid((N, N, NZ), 0.2), Beam((N, NZ), 0.2), Turntable(24), device="numpy")
    x = np.arange(N) - 0.5 * (N - 1)
    flat = (np.abs(np.hypot(x[:, None], x) - 5.0) < 2.0) & ~((x[:, None] > 0) & (np.abs(x) < 1.6))
    target = np.repeat(flat[:, :, None], NZ, axis=2).astype(float)
    state = OptimizerState(operator, operator.device.upload(target), {})
    near = (np.hypot(x[:, None], x) <= state.reach)[:, :, None] * np.ones(NZ)

    wanted = background + (1.0 - background) * target
    model, seen = wanted * near, []
    for _ in range(passes):
        projected, light = operator.device.upload(operator(model)), state.sinogram()
        state.filter(projected, ramp(operator), light)
        sent = np.maximum(light.numpy(), 0.0)
        dose = operator.T(sent)
        gain = dose[(target >= 0.5) & (near > 0)].mean()
        seen.append(sent / gain)
        model = model * np.clip(wanted / np.maximum(dose / gain, 1e-30), 0.1, 10.0)
    method = Recipe() if background == 0.6 else Recipe(background=background)
    run = OptimizerState(operator, operator.device.upload(target), {})
    for light, _ in zip(seen, method.steps(run), strict=False):
        assert np.abs(run.memory["light"].numpy() - light).max() < 1e-6 * light.max()
    found = optimize(operator, target, method, passes).sinogram.numpy()
    assert min(np.abs(found - light).max() / light.max() for light in seen) < 1e-6  # the best of them
    assert np.abs(seen[-1] - seen[0]).max() > 0.05 * seen[0].max() or passes == 1
