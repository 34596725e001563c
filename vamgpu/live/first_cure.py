"""Turbidity of a resin, from the images of its first cure."""

from __future__ import annotations

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.live.fields import added
from vamgpu.live.record import LiveRecord
from vamgpu.live.turbidity import MeasuredTurbidity, Turbidity

PARTS = 4  # parts of the images, by their distance from the axis and by height; how much they differ is the error
MODEL = 0.01  # relative error of the model's rays and kinetics, in addition to the noise
LEAST = 0.02  # least optical depth of a pixel that counts as darkened
DARKEST = 1e-6  # least share of light that a pixel sees


def turbidity_of(record: LiveRecord) -> MeasuredTurbidity:
    """Extinction of fully cured resin, from the last images of a record in fresh resin. Raises `BadInput`."""
    from scipy.optimize import least_squares

    told, loop = record.decided(), record.loop()
    last = None
    for was, (state, _) in zip(told, record.states(loop), strict=True):
        frames = record.frames(was["turn"])
        last = (state, frames) if np.isfinite(frames).any() else last
    if last is None:
        raise _uncured("no images")
    state, frames = last
    camera, estimator = loop.tomograph.camera, loop.estimator
    dose = estimator.operator.T(added(loop.field(state.shown), loop.field(state.pending), factor=-1.0)).numpy()
    depth, weight = camera.optical_depth(frames)
    used = weight > 0.0
    if not (depth[used] > LEAST).any():
        raise _uncured(f"a greatest optical depth of {depth[used].max(initial=0.0):.2g}")
    scale, number = np.sqrt(weight[used]), np.broadcast_to(_parts(depth), depth.shape)[used]

    def gaps(logs: np.ndarray) -> np.ndarray:
        gain, full = np.exp(logs)
        field = Turbidity((0.0, 1.0), (0.0, full)).extinction_at(estimator.conversion(gain * dose))
        seen = np.maximum(1.0 - camera.darkened(field.astype(np.float32)).numpy()[used], DARKEST)
        return scale * (-np.log(seen) - depth[used])

    start = np.log([1.0, loop.tomograph.turbidity.full])
    found = least_squares(gaps, start, diff_step=1e-3, x_scale=0.1, max_nfev=40)
    if not found.success or abs(found.x - start).max() > np.log(20.0):
        raise BadInput("no extinction explains the images of the last turn; expected a print in fresh resin with the "
            "light of its job: check open field, noise and place of the camera")  # fmt: skip
    each = [found.x - np.linalg.lstsq(found.jac[some], found.fun[some], rcond=None)[0]
            for some in (number == part for part in range(PARTS))]  # fmt: skip
    full, spread = float(np.exp(found.x[1])), float(np.std(each, axis=0, ddof=1)[1]) / PARTS**0.5
    return MeasuredTurbidity(full, full * float(np.hypot(spread, MODEL)))


def _parts(depth: np.ndarray) -> np.ndarray:
    """Number of the part of each pixel, [r, z]: each part has a quarter of the darkness."""
    dark = np.maximum(depth, 0.0).sum(axis=0)
    out = np.abs(np.arange(dark.shape[0]) - 0.5 * (dark.shape[0] - 1.0))
    halves = []
    for place, amount in ((out, dark.sum(axis=1)), (np.arange(dark.shape[1]), dark.sum(axis=0))):
        order = np.argsort(place, kind="stable")
        middle = place[order][np.searchsorted(np.cumsum(amount[order]), 0.5 * amount.sum())]
        halves.append((place > middle).astype(int))
    return 2 * halves[0][:, None] + halves[1]


def _uncured(seen: str) -> BadInput:
    return BadInput(f"the record has {seen}; expected a print whose resin has cured while the camera watched it")
