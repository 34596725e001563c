"""The camera that watches a print: images of light through the vial, or scattered in it, and fields from images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.kernels.camera import FAINTEST, dim_light, measure_depth
from vamgpu.operators.blur import Blur
from vamgpu.operators.projection import Projection
from vamgpu.operators.space import require
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, Place, Quantity, Turn

Bits = Annotated[int, Quantity(least=1.0, most=16.0, whole=True)]

TAIL = 5.0  # standard deviations after which a point spread is cut off, plus one pixel
LEAST = 1e-6  # share of a column's light that must enter for its pixels to count


@dataclass(frozen=True)
class SensorNoise:
    """Noise of gray levels: variance = read² + gain·level + 1/12; the last term is rounding.

    Args:
        read: Standard deviation in the dark [gray levels].
        gain: Gray levels per electron; 0 for no shot noise.
        bits: Bits per pixel; the brightest gray level is 2^bits − 1.

    Raises:
        BadInput: A value is out of its range.
    """

    read: NonNegative = 0.5
    gain: NonNegative = 0.0
    bits: Bits = 8

    def __post_init__(self) -> None:
        check(self)

    @property
    def brightest(self) -> int:
        """Greatest gray level."""
        return 2**self.bits - 1

    def variance(self, images: np.ndarray) -> np.ndarray:
        """Variance of gray levels.

        Args:
            images: Gray levels, (...,).

        Returns:
            Variance [gray levels²], (...,).
        """
        return self.read**2 + self.gain * np.maximum(images, 0.0) + 1.0 / 12.0

    def expose(self, images: np.ndarray, seed: int) -> np.ndarray:
        """Gray levels with the sensor's noise.

        Args:
            images: Gray levels, (...,).
            seed: Seed of the random numbers.

        Returns:
            Whole gray levels from 0 to the brightest, uint16 (...,).
        """
        rng = np.random.default_rng(seed)
        levels = self.gain * rng.poisson(np.maximum(images, 0.0) / self.gain) if self.gain else images
        levels = np.rint(levels + rng.normal(0.0, self.read, np.shape(images)))
        return np.clip(levels, 0, self.brightest).astype(np.uint16)


@dataclass(frozen=True)
class CameraPose:
    """Where the axis of rotation and the middle of the grid appear in the images.

    Args:
        axis: Position of the axis from the middle of the image, along columns [mm].
        height: Position of the middle of the grid from the middle of the image, along rows [mm].
        roll: Rotation of the image about the middle of the grid, from columns to rows [rad].

    Raises:
        BadInput: A value is not finite.
    """

    axis: Place = 0.0
    height: Place = 0.0
    roll: Turn = 0.0

    def __post_init__(self) -> None:
        check(self)

    @property
    def centered(self) -> bool:
        """Whether images already have the geometry of the projection."""
        return self == CameraPose()

    def seen(self, images: np.ndarray, pitch: float) -> np.ndarray:
        """Turn centered images into images of a camera in this pose.

        Args:
            images: Gray levels or other values, [angle, row, column].
            pitch: Pitch of a pixel [mm].

        Returns:
            The images, [angle, row, column].
        """
        turn, shift = self._turn, np.array([self.height, self.axis]) / pitch
        return _resampled(images, turn.T, -turn.T @ shift)

    def _centering(self, images: np.ndarray, pitch: float) -> np.ndarray:
        """Turn images of a camera in this pose, [angle, row, column], into centered ones."""
        return _resampled(images, self._turn, np.array([self.height, self.axis]) / pitch)

    @property
    def _turn(self) -> np.ndarray:
        """Map from centered (row, column) to those of the images."""
        cosine, sine = np.cos(self.roll), np.sin(self.roll)
        return np.array([[cosine, sine], [-sine, cosine]])


def _resampled(images: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Images whose pixel p, counted from the middle, is the pixel at turn·p + shift; edge values continue outside."""
    from scipy.ndimage import affine_transform  # takes longer to load than all of vamgpu

    middle = 0.5 * (np.array(images.shape[1:]) - 1.0)
    offset = middle + shift - turn @ middle
    return np.stack(
        [affine_transform(image, turn, offset=offset.tolist(), order=3, mode="nearest") for image in images]
    )


@dataclass(frozen=True, eq=False)
class MonitoringCamera:
    """A telecentric camera, opposite to or at an angle to collimated light that resin does not absorb.

    Each pixel sees along one ray. Its geometry is therefore a `Projection` with the camera's pixels, spread and angles,
    and the vial's indices at its wavelength. In images [angle, row, column] rows count along z and columns along r.

    To first order: scattered light is lost to the view through the vial, and light scattered into the view at an angle
    is not attenuated.

    Args:
        projection: The rays. Its vessel must absorb nothing: absorption before the print is part of the open field.
        open_field: Gray levels through the vial before the print, with the vignetting of light and lens:
            [row, column], or [angle, row, column] of one turn, or one number.
        noise: Noise of the sensor.
        pose: Pose of the sensor.
        focus: Distance of the camera's focus downstream of the axis [mm]. Cured resin with another index bends light;
            the brightness of edges is proportional to this distance.

    Raises:
        BadInput: The vessel absorbs, or the open field is dark, not finite, or saturates the sensor throughout.
        ShapeMismatch: The open field is not of this camera.
    """

    projection: Projection
    open_field: Any
    noise: SensorNoise = SensorNoise()
    pose: CameraPose = CameraPose()
    focus: Place = 0.0

    def __post_init__(self) -> None:
        check(self)
        vessel = self.projection.vessel
        if vessel is not None and vessel.absorption > 0:
            raise BadInput(f"got {vessel!r}, which absorbs; expected one of absorption 0: the open field already "
                           "contains the absorption before the print")  # fmt: skip
        field = np.asarray(self.open_field, np.float32)
        if field.shape not in ((), self.shape[1:], self.shape):
            raise ShapeMismatch(f"the open field has shape {field.shape}; expected {self.shape[1:]} = [row, column], "
                                f"or {self.shape} = [angle, row, column]")  # fmt: skip
        if not np.isfinite(field).all() or field.min() < 0 or field.max() <= 0:
            raise BadInput("the open field is dark, negative or not finite; expected gray levels of the lit vial")
        if field.min() >= self.noise.brightest:
            raise BadInput(f"the open field is {field.min():g} or more everywhere, but the sensor's brightest level is "
                           f"{self.noise.brightest}; expected less: weaken the light, or set bits")  # fmt: skip
        object.__setattr__(self, "open_field", field)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the images of a turn: angles, rows, columns."""
        angles, columns, rows = self.projection.range.shape
        return angles, rows, columns

    def transmitted(self, extinction: Any, index: Any = None) -> np.ndarray:
        """The view through the vial.

        Args:
            extinction: Extinction of the resin above that before the print [1/mm], [x, y, z].
            index: Change of the refractive index, [x, y, z]; None for none.

        Returns:
            Gray levels without noise, [angle, row, column].

        Raises:
            ShapeMismatch: A field is not of the projection's grid.
        """
        return self._as_images(1.0 - self.darkened(extinction, index).numpy()) * self.open_field

    def darkened(self, extinction: Any, index: Any = None) -> DeviceArray:
        """Share of the open field's light that a centered camera does not receive.

        Args:
            extinction: As for `transmitted`, [x, y, z], NumPy or on the device.
            index: As for `transmitted`, [x, y, z].

        Returns:
            The share, [angle, r, z] on the device.

        Raises:
            ShapeMismatch: A field is not of the projection's grid.
        """
        require(self.projection.domain, extinction, "the field")
        device = self.projection.device
        dark = self._sharp(device.field(extinction))
        device.launch(dim_light, path=dark, reached=self.share, dark=dark)
        if index is not None and self.focus:
            bent = np.maximum(1.0 - self.focus * self._curvature(self._lengths(index)), 0.0)
            dark = device.upload(1.0 - (1.0 - dark.numpy()) * bent)
        return dark if self._blur is None else self._blur(dark)  # beyond the image nothing is dark

    def scattered(self, scattering: Any, background: Any = 0.0) -> np.ndarray:
        """The view at an angle to the light: each pixel sums the light scattered along its ray.

        Args:
            scattering: Share of the light scattered into the view per length [1/mm], [x, y, z].
            background: Gray levels without a print, a number or [row, column] or [angle, row, column].

        Returns:
            Gray levels without noise, [angle, row, column].

        Raises:
            ShapeMismatch: The field is not of the projection's grid.
        """
        return self._as_images(self._spread(self._lengths(scattering))) * self.open_field + background

    def _lengths(self, field: Any) -> np.ndarray:
        """Integrals along the rays of a field per mm, [angle, r, z]."""
        require(self.projection.domain, field, "the field")
        reached = self.reached
        through = np.asarray(self._sharp(np.asarray(field, np.float32)))
        return through * np.where(reached > 0, 1.0 / np.maximum(reached, LEAST), 0.0)

    def _curvature(self, path: np.ndarray) -> np.ndarray:
        """Σ of the second derivatives of optical path [mm] across an image, divided by the resin's index [1/mm]."""
        pitch, vessel = self.projection.beam.pitch, self.projection.vessel
        bent = np.zeros_like(path)
        for axis in (1, 2):
            if path.shape[axis] > 1:
                edge = [(0, 0)] * 3
                edge[axis] = (1, 1)
                bent += np.diff(np.pad(path, edge, "edge"), 2, axis=axis)
        return bent / (pitch**2 * getattr(vessel, "resin_index", 1.0))

    def _spread(self, light: np.ndarray) -> np.ndarray:
        return light if self._blur is None else np.asarray(self._blur(light.astype(np.float32)))

    def _as_images(self, light: np.ndarray) -> np.ndarray:
        images = light.swapaxes(1, 2)
        return images if self.pose.centered else self.pose.seen(images, self.projection.beam.pitch)

    @cached_property
    def reached(self) -> np.ndarray:
        """Share of the light of each column that the projection includes, by its transmittance (columns, 1)."""
        A = self.projection
        columns = A.beam.columns()
        return (np.ones(columns.size) if A.vessel is None else A.vessel.chords(columns).transmittance)[:, None]

    @cached_property
    def share(self) -> DeviceArray:
        """`reached` as a table on the device, 0 where it is negligible."""
        return self.projection.device.table(np.where(self.reached > LEAST, self.reached, 0.0)[:, 0])

    @cached_property
    def _open(self) -> DeviceArray:
        """The open field, of one image or of each."""
        field = self.open_field if self.open_field.ndim == 3 else np.broadcast_to(self.open_field, self.shape[1:])[None]
        return self.projection.device.table(field)

    @cached_property
    def _sharp(self) -> Projection:
        """The rays without spread: the spread blurs light, not the logarithm of light."""
        A = self.projection
        return Projection(A.grid, replace(A.beam, fill=1.0, spread=0.0), A.motion, A.vessel, A.device)

    @cached_property
    def _blur(self) -> Blur | None:
        """A discrete Gaussian with the same variance."""
        from scipy.special import ive  # takes longer to load than all of vamgpu

        A, sigma = self.projection, self.projection.beam.sigma
        if not sigma:
            return None
        taps = ive(np.arange(2 + int(TAIL * sigma)), sigma**2)
        taps /= 2.0 * taps.sum() - taps[0]
        return Blur(A.range, A.device, taps, np.ones(1) if A.beam.flat else taps)

    def optical_depth(self, images: Any) -> tuple[np.ndarray, np.ndarray]:
        """Optical depth of a print, and its weight.

        Pixels that are saturated, not finite (a lost frame is NaN throughout), or darker than twice their noise have
        weight 0. The open field is assumed to be exact.

        Args:
            images: Gray levels [angle, row, column].

        Returns:
            −ln(image / open field), centered, and the inverse of its variance, both [angle, r, z].

        Raises:
            ShapeMismatch: The images are not of this camera.
        """
        levels = self._levels(images)
        variance = self.noise.variance(levels)
        with np.errstate(invalid="ignore"):
            good = (levels**2 > FAINTEST**2 * variance) & (levels < self.noise.brightest) & (self.open_field > 0)
        depth = np.zeros_like(levels)
        np.log(np.broadcast_to(self.open_field, self.shape) / np.where(good, levels, 1.0), out=depth, where=good)
        weight = np.where(good, levels**2 / np.where(good, variance, 1.0), 0.0)
        if not self.pose.centered:
            pitch = self.projection.beam.pitch
            known = self.pose._centering(good.astype(np.float32), pitch) > 0.99  # no spline through unknown values
            depth = self.pose._centering(depth, pitch)
            weight = np.where(known, np.maximum(self.pose._centering(weight, pitch), 0.0), 0.0)
        return depth.swapaxes(1, 2), weight.swapaxes(1, 2)

    def measured(self, images: Any) -> tuple[DeviceArray, DeviceArray]:
        """`optical_depth` in the projection's geometry, multiplied by the share of its column's light that enters.

        Args:
            images: Gray levels [angle, row, column].

        Returns:
            Depth, and the inverse of its variance, both [angle, r, z] on the device.

        Raises:
            ShapeMismatch: The images are not of this camera.
        """
        device, levels = self.projection.device, self._levels(images)
        if not self.pose.centered:
            depth, weight = self.optical_depth(levels)
            share = np.where(self.reached > LEAST, self.reached, 0.0)
            known = np.divide(weight, share**2, out=np.zeros_like(weight), where=share > 0.0)
            return device.upload(depth * share), device.upload(known)
        if np.asarray(images).dtype.kind == "f":
            levels = np.nan_to_num(levels, posinf=self.noise.brightest)  # a level of 0 has no depth
        shown = device.table(levels)
        depth, weight = (device.empty(self.projection.range.shape) for _ in range(2))
        device.launch(
            measure_depth, images=shown, open=self._open, reached=self.share, floor=self.noise.read**2 + 1.0 / 12.0,
            gain=self.noise.gain, brightest=float(self.noise.brightest), depth=depth, weight=weight,
        )  # fmt: skip
        return depth, weight

    def _levels(self, images: Any) -> np.ndarray:
        levels = np.asarray(images, np.float32)
        if levels.shape != self.shape:
            raise ShapeMismatch(f"the images have shape {levels.shape}; expected {self.shape} = [angle, row, column]")
        return levels
