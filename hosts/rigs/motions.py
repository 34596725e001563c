"""Parts that move (the controller's own motor, stages and steppers), and clocks that time the frames."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers import stepper
from vamgpu.hosts.drivers.controller_protocol import STEEPEST
from vamgpu.hosts.drivers.micromanager import MicroManagerStage
from vamgpu.hosts.drivers.stages import Stage, StandaStage, ZaberStage
from vamgpu.hosts.drivers.stepper import GpioIndex
from vamgpu.hosts.drivers.thorlabs import ThorlabsStage
from vamgpu.hosts.rigs.roles import CRYSTAL, Microsteps, MotionPart, Part, Ppm, StagePart
from vamgpu.hosts.schedules.clock import RealClock
from vamgpu.schema.quantities import Count


class ControllerMotion(MotionPart):
    """The motor that the controller steps; rows are triggered by its steps.

    ramp: acceleration of the motion [mm/s2] or [deg/s2]; by default that of the controller's firmware.
    """

    triggers: ClassVar[bool] = True
    microsteps: Microsteps  # type: ignore[assignment]  # of motor and gear: no machine tells them
    ramp: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _stepped(self) -> ControllerMotion:
        if self.ramp is not None and self.ramp * self.microsteps > STEEPEST:
            found = self.ramp * self.microsteps
            raise ValueError(f"ramp = {self.ramp:g} is {found:.4g} microsteps/s2; expected at most {STEEPEST:.4g}")
        return self


class ZaberMotion(StagePart):
    """A stage by Zaber, whose trigger output can fire at every pose.

    port: serial port, or socket://host:port.  device: device number on the line.  axis: axis number of the device.
    """

    triggers: ClassVar[bool] = True
    scaled: ClassVar[bool] = True
    port: str
    microsteps: Microsteps = 6400.0 / 3.0
    device: Count = 1
    axis: Count = 1

    def open(self, unit: str) -> Stage:
        return ZaberStage.open(self.port, self.microsteps, unit, self.device, self.axis, encoder=self.encoder)


class StandaMotion(StagePart):
    """A stage by Standa (8SMC5).

    port: address, such as xi-com:///dev/ttyACM0.  microsteps: full steps per millimeter or degree, of 256 each.
    """

    port: str
    microsteps: Microsteps  # type: ignore[assignment]  # it differs between their stages

    def open(self, unit: str) -> Stage:
        return StandaStage.open(self.port, self.microsteps, unit)


class ThorlabsMotion(StagePart):
    """A stage on a motion cube by Thorlabs (K-Cube, T-Cube).

    port: serial port.  microsteps: encoder counts per millimeter or degree.
    """

    port: str
    microsteps: Microsteps  # type: ignore[assignment]  # it differs between their stages

    def open(self, unit: str) -> Stage:
        return ThorlabsStage.open(self.port, self.microsteps, unit)


class MicroManagerMotion(StagePart):
    """A stage that Micro-Manager drives, through pymmcore-plus; it only moves to positions, so it cannot run prints.

    config: its configuration file.  label: label of the stage in it.  speed_property: property with its speed [mm/s].
    """

    runs: ClassVar[bool] = False
    config: str
    label: str
    speed_property: str | None = None
    microsteps: Microsteps = 1000.0

    def open(self, unit: str) -> Stage:
        """See `MotionPart`. Raises `BadInput` for degrees."""
        if unit != "mm":
            raise BadInput(
                f"the stage {self.label!r} of Micro-Manager moves in mm, and the job needs {unit}: use another"
            )
        return MicroManagerStage.open(self.config, self.label, self.speed_property)


class StepperMotion(MotionPart):
    """A stepper driven by a computer's hardware PWM, such as a Raspberry Pi's; its position is not measured.

    chip: chip of the PWM, as in /sys/class/pwm.  channel: channel of the PWM.  ramp: acceleration [mm/s2] or [deg/s2].
    """

    reports: ClassVar[bool] = False
    chip: Annotated[int, Field(ge=0)] = 0
    channel: Annotated[int, Field(ge=0)] = 0
    microsteps: Microsteps  # type: ignore[assignment]  # of motor and gear: no machine tells them
    ramp: Annotated[float, Field(gt=0)] = 100.0
    tolerance: Ppm = CRYSTAL

    def open(self, unit: str, pin: int | None = None) -> Stage:
        """See `MotionPart`. pin: input of its index; None without an index."""
        clock = RealClock()
        pulses = stepper.SysfsPwm(self.chip, self.channel)
        index = None if pin is None else GpioIndex.open(pin, clock)
        return stepper.StepperStage(pulses, clock, self.microsteps, unit, self.ramp, index)


class EmulatedMotion(MotionPart):
    """The emulated motion."""

    emulated: ClassVar[bool] = True
    triggers: ClassVar[bool] = True


class ControllerClock(Part):
    """The controller triggers the mirrors, row by row, by the steps of its own motor."""


class StageClock(Part):
    """The trigger output of the stage triggers the mirrors at every pose."""


class RefreshClock(Part):
    """The projector's vertical blanking; at every refresh, the angle that the stage reports selects the frame."""


class FreeClock(Part):
    """No common clock: projector and motion each run on their own clock, and drift apart."""
