"""Every error that this library raises; each message states what was got, what was expected and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class VamError(Exception):
    """Root of all errors of vamgpu."""


class BadInput(VamError, ValueError):
    """A value from the caller cannot be used."""


class ShapeMismatch(BadInput):
    """An array has another shape than an operator or kernel needs."""


class MeshError(BadInput):
    """A mesh cannot be used as a print target."""


class EmptyMesh(MeshError):
    """A mesh file contains no triangles."""


class NotWatertight(MeshError):
    """A mesh has holes that could not be closed, so inside and outside are undefined."""


class TargetTooLarge(BadInput):
    """A target extends beyond the region that light can print."""


class NoLight(BadInput):
    """Light is missing: it does not reach the part, or the patterns are dark."""


class TileError(BadInput):
    """A stream of tiles broke off, or changed its section or pitch; what was already written stays valid."""


class SkippedColumns(BadInput):
    """The steps of a web from angle to angle are so long that some of its columns are never lit."""


class RayError(BadInput):
    """A ray cannot be traced: it never leaves, is reflected where it should pass, or does not converge."""


class MaterialError(BadInput):
    """A material is unknown, or its file holds a wrong value."""


class OutsideData(BadInput):
    """A wavelength or temperature lies outside the data of a material."""


class UnstableStep(BadInput):
    """An explicit step is too long to be stable; ``limit`` is the longest stable step [s]."""

    def __init__(self, message: str, limit: float) -> None:
        super().__init__(message)
        self.limit = limit


class ToleranceError(BadInput):
    """A tolerance contradicts another one or the print, or no patterns meet it; ``binds`` names it, such as "axis"."""

    def __init__(self, binds: str, why: str) -> None:
        super().__init__(f"the tolerance of {binds} {why}")
        self.binds: str = binds


class SliceError(BadInput):
    """A stack of slices cannot be used: one is missing, misnumbered, damaged, or unlike the others."""


class DeviceError(VamError, RuntimeError):
    """A device is missing or broken, or cannot do what is required."""


class OutOfMemory(DeviceError):
    """A device has too little memory for an array."""


class TransferForbidden(DeviceError):
    """An array would have been transferred between host and device inside ``no_transfers()``."""


class KernelError(DeviceError):
    """A kernel got arguments that do not fit its declaration, or did not compile."""


class WorkerLost(DeviceError):
    """A process of a cluster is gone, with all its data."""


class DeviceNotFound(DeviceError):
    """A configured machine does not answer at its address."""


class DeviceLost(DeviceError):
    """A machine no longer answers: it is unplugged, without power, or hung."""


class OriginLost(DeviceLost):
    """A machine lost the state of a running print; the print cannot be continued."""


class DeviceBusy(DeviceError):
    """Another program uses the machine."""


class WrongDevice(DeviceError):
    """A machine answers, but is not the configured one, or its firmware lacks a required function."""


class DeviceRefused(DeviceError):
    """A machine understood a command and rejected it; ``code`` is its reason."""

    def __init__(self, message: str, code: str = "") -> None:
        super().__init__(message)
        self.code = code


class ProtocolError(DeviceError):
    """A line received no valid message: the message was cut short, malformed, or of another protocol."""


class TimingInfeasible(BadInput):
    """A machine is too slow; ``limit`` names what limits it, ``speed`` is the greatest possible speed, in ``unit``."""

    def __init__(self, message: str, limit: str, speed: float, unit: str) -> None:
        super().__init__(message)
        self.limit = limit
        self.speed = speed
        self.unit = unit


class Underrun(DeviceError):
    """Too many frames came too late; the light was turned off and then the motion stopped."""


class WrongKey(NamedTuple):
    """One wrong value of a file."""

    key: str  # such as "vial.radius"; empty if unknown
    line: int | None  # from 1
    message: str


class JobError(BadInput):
    """A job file holds a wrong value; ``wrong`` has the key and line of each, as far as they are known."""

    def __init__(self, message: str, wrong: Iterable[WrongKey] = ()) -> None:
        super().__init__(message)
        self.wrong: tuple[WrongKey, ...] = tuple(wrong)


class StorageError(VamError, OSError):
    """A job folder or export could not be written or read."""


class Cancelled(VamError):
    """A run was stopped by its caller; ``plan`` holds its result so far (None before the first patterns)."""

    def __init__(self, message: str, plan: object | None = None) -> None:
        super().__init__(message)
        self.plan = plan


class MeshWarning(UserWarning):
    """A mesh had faults that were repaired; the message says which."""


class Diverged(VamError, ArithmeticError):
    """A loss became infinite or no number; ``plan`` has the best patterns before, ``iteration`` is where it rose."""

    def __init__(self, message: str, plan: object | None = None, iteration: int = 1) -> None:
        super().__init__(message)
        self.plan = plan
        self.iteration = iteration


class DivergenceWarning(UserWarning):
    """A method's loss rose instead of falling; the message names the iteration at which that began."""


class OpticsWarning(UserWarning):
    """Light reaches part of the target so weakly that the print will suffer there."""


class DoseWarning(UserWarning):
    """A print gives a dose that differs from the proved one; the message states both, and the effect."""


class SamplingWarning(OpticsWarning):
    """Voxels or angles are too coarse for the pixels of a projector; the message states what suffices."""


class PackWarning(UserWarning):
    """Frames differ from the requested settings, which would show the patterns worse."""


class MemoryNotice(UserWarning):
    """A method shrank its working memory to fit the device."""


class ClusterWarning(UserWarning):
    """A run lost a worker and continues from the last saved plan."""


class SliceWarning(UserWarning):
    """Slices, their settings or measurements of a resin are usable but probably not intended."""


class ToleranceWarning(UserWarning):
    """The patterns do not print at every corner of their tolerances."""
