"""Every error this library raises on purpose; each message says what was got, what was expected and what to do."""

from __future__ import annotations


class VamError(Exception):
    """Root of all errors raised on purpose by vamgpu."""


class BadInput(VamError, ValueError):
    """A value the caller gave cannot be used."""


class ShapeMismatch(BadInput):
    """An array does not live in the space an operator or kernel works on."""


class MeshError(BadInput):
    """A mesh cannot be used as a print target."""


class EmptyMesh(MeshError):
    """A mesh file holds no triangles."""


class NotWatertight(MeshError):
    """A mesh has holes that could not be closed, so inside and outside are undefined."""


class TargetTooLarge(BadInput):
    """A target reaches beyond what light can print."""


class NoLight(BadInput):
    """There is no light where some is needed: it does not reach the part, or there was none to begin with."""


class TileError(BadInput):
    """A stream of tiles broke off, or changed its section or pitch; what was written before stays valid."""


class SkippedColumns(BadInput):
    """A web moves so far from pose to pose that some of its columns are never lit."""


class RayError(BadInput):
    """A ray cannot be traced: it never leaves, is reflected where it should pass, or does not settle."""


class MaterialError(BadInput):
    """A material is unknown, or its file holds a wrong value."""


class OutsideData(BadInput):
    """A wavelength or temperature lies outside the data a material has."""


class UnstableStep(BadInput):
    """An explicit step is longer than is stable; ``limit`` is the longest [s] that is."""

    def __init__(self, message: str, limit: float) -> None:
        super().__init__(message)
        self.limit = limit


class ToleranceError(BadInput):
    """A tolerance contradicts another one or the print that it is of, or no light can bear it.

    Attributes:
        binds: Which one: "axis", "spread", "absorption", "dose", "index" or "wobble".
    """

    binds: str

    def __init__(self, binds: str, why: str) -> None:
        super().__init__(f"the tolerance of {binds} {why}")
        self.binds = binds


class SliceError(BadInput):
    """A stack of slices cannot be used: one is missing, misnumbered, damaged, or unlike the others."""


class DeviceError(VamError, RuntimeError):
    """A device is missing, broken, or was asked for something it cannot do."""


class OutOfMemory(DeviceError):
    """A device has too little memory for an array."""


class TransferForbidden(DeviceError):
    """An array was about to cross the bus inside ``no_transfers()``."""


class KernelError(DeviceError):
    """A kernel was bound to arguments that do not fit its declaration, or did not compile."""


class WorkerLost(DeviceError):
    """The process of a cluster that computed is gone, and with it all that it kept."""


class DeviceNotFound(DeviceError):
    """A configured machine does not answer at its address."""


class DeviceLost(DeviceError):
    """A machine that answered before does no longer: unplugged, without power, or hung."""


class OriginLost(DeviceLost):
    """A machine forgot the print that it was in the midst of; nobody can go on with it."""


class DeviceBusy(DeviceError):
    """A machine is held by another program."""


class WrongDevice(DeviceError):
    """A machine answers, but is not the one the configuration names, or its firmware cannot do what is asked."""


class DeviceRefused(DeviceError):
    """A machine understood a command and refused it; ``code`` is what it gave as the reason."""

    def __init__(self, message: str, code: str = "") -> None:
        super().__init__(message)
        self.code = code


class ProtocolError(DeviceError):
    """A line received no valid message: cut short, malformed, or of another protocol."""


class TimingInfeasible(BadInput):
    """A machine cannot keep pace; ``limit`` names what limits it, ``speed`` is the greatest that fits, in ``unit``."""

    def __init__(self, message: str, limit: str, speed: float, unit: str) -> None:
        super().__init__(message)
        self.limit = limit
        self.speed = speed
        self.unit = unit


class Underrun(DeviceError):
    """Frames came too late too often; the light was turned off and then the motion stopped."""


class JobError(BadInput):
    """A job file holds a wrong value."""


class StorageError(VamError, OSError):
    """A job folder or export could not be written or read."""


class Cancelled(VamError):
    """A run was stopped by its caller; ``plan`` holds what it had reached (None before the first light)."""

    def __init__(self, message: str, plan: object | None = None) -> None:
        super().__init__(message)
        self.plan = plan


class MeshWarning(UserWarning):
    """A mesh had faults that were mended; the message says which."""


class Diverged(VamError, ArithmeticError):
    """A method's loss became infinite or not a number.

    Attributes:
        plan: A `Plan` of the best light found before, or None where there was none.
        iteration: The iteration from which the loss only rose, counted from 1.
    """

    def __init__(self, message: str, plan: object | None = None, iteration: int = 1) -> None:
        super().__init__(message)
        self.plan = plan
        self.iteration = iteration


class DivergenceWarning(UserWarning):
    """A method's loss rose instead of falling; the message names the iteration at which that began."""


class OpticsWarning(UserWarning):
    """Light reaches part of the target so weakly that the print will suffer there."""


class DoseWarning(UserWarning):
    """A print gives another dose than the one that was proved; the message says which, and what that changes."""


class SamplingWarning(OpticsWarning):
    """Voxels or angles are too coarse for the pixels of a projector; the message says what would do."""


class PackWarning(UserWarning):
    """Frames are made in another way than asked for, because what was asked for would show the light worse."""


class MemoryNotice(UserWarning):
    """A method shrank its working memory to fit the device."""


class ClusterWarning(UserWarning):
    """A run lost a worker and goes on without what that one had done since a plan was kept."""


class SliceWarning(UserWarning):
    """A stack of slices, or what is asked of it, is usable but likely not what was meant."""


class ToleranceWarning(UserWarning):
    """Light was found that does not print at every corner of its tolerances."""
