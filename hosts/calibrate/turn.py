"""Degrees of the vial per degree that its motion reports: a camera watches a mark on the vial for some turns."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate.machines import CalibrationMachines, Progress, need, silent
from vamgpu.hosts.calibrate.report import CalibrationResult

WAVES = 20  # waves per turn of the mark's light
COARSE = 16  # blocks of an image along each side
VARIED = 4  # components of the images that are kept
APART = 0.2  # greatest relative error of a turn that is searched for
LEAST = 0.5  # share of the images' change that a mark must explain
RUN_UP = 3.0  # time before the first image [s]
IMAGES = 60  # images per turn
OFTEN = 200_000_000  # longest time between two queries of the motion [ns]


def turn(
    machines: CalibrationMachines, *, speed: float = 40.0, turns: int = 10, progress: Progress = silent
) -> CalibrationResult:
    """Measure the turn of the vial in degrees that its motion reports."""
    if turns < 3 or not speed > 0:
        raise BadInput(f"{turns} turns at {speed:g} deg/s; expected 3 turns or more, and a speed above 0")
    clock, stage, times, places, images = machines.clock, need(machines.stage, "motion"), [], [], []
    camera = need(machines.camera, "camera")
    camera.expose(1e6 * need(machines.rig.camera, "camera").exposure)
    stage.run(speed)
    try:
        begin, apart = clock.now() + round(RUN_UP * 1e9), 360.0 / IMAGES / speed * 1e9
        while not places or places[-1] - places[0] < 360.0 * turns:
            due = begin + round(len(places) * apart)
            while (now := clock.now()) < due:
                clock.sleep_until(min(due, now + OFTEN))
                stage.position()  # some motions stop if they are not queried
            images.append(_blocks(camera.grab()))
            times.append(clock.now() * 1e-9)
            places.append(stage.position())
            progress(min((places[-1] - places[0]) / (360.0 * turns), 1.0))
    finally:
        stage.run(0.0)
    return _found(np.array(times), np.array(places), np.array(images), machines.rig.motion.microsteps)


def _blocks(image: np.ndarray) -> np.ndarray:
    """Means of the blocks of an image, flat."""
    rows, columns = (max(length // COARSE, 1) for length in image.shape)
    whole = image[: image.shape[0] // rows * rows, : image.shape[1] // columns * columns].astype(float)
    return whole.reshape(whole.shape[0] // rows, rows, -1, columns).mean(axis=(1, 3)).ravel()


def _left(places: np.ndarray, signals: np.ndarray, ratio: float) -> float:
    """Sum of squares that waves of a turn do not explain."""
    wave = np.radians(ratio * places)[:, None] * np.arange(1, WAVES + 1)
    terms = np.hstack([np.ones((places.size, 1)), np.cos(wave), np.sin(wave)])
    return float(np.sum(signals**2) - np.sum((np.linalg.qr(terms)[0].T @ signals) ** 2))


def _found(times: np.ndarray, places: np.ndarray, images: np.ndarray, microsteps: float) -> CalibrationResult:
    change = images - images.mean(axis=0)
    u, size, _ = np.linalg.svd(change, full_matrices=False)
    signals = (u * size)[:, :VARIED]
    places = places - places.mean()
    step = 360.0 / np.ptp(places) / (4 * WAVES)
    ratios = np.arange(1.0 - APART, 1.0 + APART, step)
    left = np.array([_left(places, signals, ratio) for ratio in ratios])
    ratio = float(ratios[left.argmin()])
    for _ in range(8):  # parabolas through three points, each nearer
        low, mid, high = (_left(places, signals, ratio + sign * step) for sign in (-1, 0, 1))
        bend = low - 2 * mid + high
        ratio += float(np.clip(0.5 * step * (low - high) / bend, -step, step)) if bend > 0 else 0.0
        curvature, step = bend / step**2, step / 2
    rest = _left(places, signals, ratio)
    seen = float(np.sum(signals**2))
    explained = 1.0 - rest / seen if seen > 0.0 else 0.0
    if explained < LEAST:
        raise BadInput(
            f"the turn explains {100 * explained:.0f} % of the images' change; expected {100 * LEAST:.0f} % or more: "
            "draw a mark on the vial that the camera sees once a turn, and keep its light even"
        )
    error = float(np.sqrt(2.0 * rest / (places.size - 2 * WAVES - 2) / max(curvature, 1e-300)))
    rpm = float(np.polyfit(times - times.mean(), places, 1)[0]) * ratio / 6.0
    numbers = {"ratio": ratio, "error": error, "rpm": rpm, "microsteps": microsteps / ratio, "explained": explained}
    lines = (
        ("per reported degree", f"{ratio:.6f} ± {error:.1g} deg of the vial"),
        ("speed", f"{rpm:.4f} rpm, {6.0 * rpm:.4f} deg/s"),
        ("the mark explains", f"{100 * explained:.1f} % of the images' change"),
    )
    readings = {"times": times, "places": places, "images": images, "ratios": ratios, "left": left}
    return CalibrationResult("turn", numbers, readings, lines, lambda axes: _draw(axes, places * ratio, signals[:, 0]))


def _draw(axes: Any, angles: np.ndarray, signal: np.ndarray) -> None:
    axes.plot(angles % 360.0, signal, ".", color="#2563a8", ms=3)
    axes.set(title="The mark over the vial's angle", xlabel="angle [deg]", ylabel="change of the image")
