"""Checks, noise, fits and files shared by calibrations."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.storage.reading import load_toml


def check_finite(what: str, *values: np.ndarray) -> None:
    """Raise `BadInput` if readings or pictures are not finite."""
    if not all(np.isfinite(each).all() for each in values):
        raise BadInput(f"the {what} hold values that are not finite; expected finite numbers, as they were read")


def noise_of(values: np.ndarray) -> float:
    """Standard deviation of a value, from the median difference of neighbors, which edges hardly affect."""
    return 1.4826 * float(np.median(np.abs(np.diff(values, axis=0)))) / float(np.sqrt(2.0))


def fitted(
    curve: Callable[..., np.ndarray], x: np.ndarray, y: np.ndarray, start: Sequence[float], refusal: str, remedy: str,
    *, evaluations: int = 4000,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Least-squares parameters of a curve and their covariance. Raises `BadInput` if the fit fails."""
    from scipy.optimize import OptimizeWarning, curve_fit

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", OptimizeWarning)
            return curve_fit(curve, x, y, p0=start, maxfev=evaluations)
    except (RuntimeError, OptimizeWarning) as error:
        raise BadInput(f"{refusal}: {error}; {remedy}") from error


def read_result(path: str | Path, kind: str, numbers: Callable[[dict[str, Any]], Any]) -> tuple[Any, str]:
    """Numbers of a calibration's ``result.toml`` or its folder, and the file. Raises `BadInput`, `StorageError`."""
    file = Path(path) / "result.toml" if Path(path).is_dir() else Path(path)
    data = load_toml(file, "the calibration")
    known = data.get("calibration", "none")
    if known != kind:
        raise BadInput(
            f"{str(file)!r} holds the calibration {known!r}; expected {kind!r}, which vam calibrate {kind} writes"
        )
    try:
        return numbers(data["measured"]), str(file)
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(f"{str(file)!r} has malformed numbers: {error}; run vam calibrate {kind} again") from error
