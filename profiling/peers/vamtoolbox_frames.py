"""VAMToolbox's entry in the leaderboard: ``vamtoolbox_frames.py CASE OUT --method OSMO``.

Options are those of its own examples. Its projector knows straight rays; a voxel is as wide as a pixel in the resin.
"""

from __future__ import annotations

import numpy as np
import pyglet

np.product = np.prod  # type: ignore[attr-defined] # its PM and BCLP call what NumPy 2 no longer has
pyglet.options["headless"] = True  # it looks for a screen when it is imported

import vamtoolbox as vam  # noqa: E402

from profiling.leaderboard.entry import Case, Found, enter  # noqa: E402

OPTIONS = {
    "OSMO": {"n_iter": 20, "d_h": 0.85, "d_l": 0.6, "filter": "hamming"},
    "PM": {"n_iter": 100, "d_h": 0.8, "d_l": 0.7, "filter": "ram-lak"},
    "CAL": {"n_iter": 100, "d_h": 0.8, "d_l": 0.7, "filter": "shepp-logan"},
    "BCLP": {"n_iter": 30, "filter": "ram-lak", "p": 2, "learning_rate": 1e-5, "eps": 0.1},
}


def solve(case: Case, method: str, iterations: int) -> Found:
    """The sinogram of one of its optimizers."""
    target = vam.geometry.TargetGeometry(target=case.voxels().astype(float))
    turns = np.linspace(0.0, 360.0, case.shape[0], endpoint=False)
    rays = vam.geometry.ProjectionGeometry(turns, ray_type="parallel", CUDA=False)
    options = OPTIONS[method] | {"n_iter": iterations}
    if method == "BCLP":
        options["response_model"] = vam.response.ResponseModel(B=25)
    found = vam.optimize.optimize(target, rays, vam.optimize.Options(method=method, **options))
    # its sinograms are [column, angle, row]
    return Found(np.asarray(found[0].array, float).swapaxes(0, 1), {"options": str(OPTIONS[method])})


if __name__ == "__main__":
    enter("VAMToolbox", vam.__version__, solve, {name: int(each["n_iter"]) for name, each in OPTIONS.items()})
