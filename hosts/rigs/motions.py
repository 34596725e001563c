"""Parts that move (the controller's own motor, stages and steppers), and clocks that time the frames."""

from __future__ import annotations

import re
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from vamgpu.hosts.drivers import stepper
from vamgpu.hosts.drivers.controller_protocol import STEEPEST
from vamgpu.hosts.drivers.stages import Stage, StandaStage, ZaberStage
from vamgpu.hosts.drivers.stepper import GpioIndex
from vamgpu.hosts.drivers.text_stage import Dialogue, GrblStage, TextStage, grbl
from vamgpu.hosts.drivers.thorlabs import ThorlabsStage
from vamgpu.hosts.drivers.tic import TicStage
from vamgpu.hosts.drivers.tmc2209 import Tmc2209Stage
from vamgpu.hosts.rigs.roles import CRYSTAL, Baud, Microsteps, MotionPart, Part, Ppm, StagePart
from vamgpu.hosts.schedules.clock import RealClock
from vamgpu.schema.quantities import Count

Output = Annotated[int, Field(ge=1, le=4)]  # Zaber's stages have at most four digital outputs

FIELD = re.compile(r"\{(speed|rate|steps_per_s|position|steps)(:\.?\d{0,2}[dfg])?\}")  # in the lines of a firmware


class ControllerMotion(MotionPart):
    """The motor that the controller steps; rows are triggered by its steps.

    ramp: acceleration of the motion [mm/s2] or [deg/s2]; by default that of the controller's firmware.
    """

    triggers: ClassVar[bool] = True
    ramp: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _stepped(self) -> ControllerMotion:
        if self.ramp is not None and self.ramp * self.microsteps > STEEPEST:
            found = self.ramp * self.microsteps
            raise ValueError(f"ramp = {self.ramp:g} is {found:.4g} microsteps/s2; expected at most {STEEPEST:.4g}")
        return self


class ZaberMotion(StagePart):
    """A stage by Zaber, whose trigger output can fire at every angle.

    port: serial port, or socket://host:port.  device: device number on the line.  axis: axis number of the device.
    output: digital output that triggers the mirrors.  gate: digital output that is high while the other triggers, for
    a board that joins both.
    """

    triggers: ClassVar[bool] = True
    scaled: ClassVar[bool] = True
    port: str
    microsteps: Microsteps = 6400.0 / 3.0
    device: Count = 1
    axis: Count = 1
    output: Output = 1
    gate: Output | None = None

    @model_validator(mode="after")
    def _apart(self) -> ZaberMotion:
        if self.gate == self.output:
            raise ValueError(f"output and gate are both {self.gate}; expected two outputs of the stage")
        return self

    def open(self, unit: str) -> Stage:
        options = {"encoder": self.encoder, "output": self.output, "gate": self.gate}
        return ZaberStage.open(self.port, self.microsteps, unit, self.device, self.axis, **options)


class StandaMotion(StagePart):
    """A stage by Standa (8SMC5).

    port: address, such as xi-com:///dev/ttyACM0.  microsteps: full steps per millimeter or degree, each of 256 parts.
    """

    port: str

    def open(self, unit: str) -> Stage:
        return StandaStage.open(self.port, self.microsteps, unit)


class ThorlabsMotion(StagePart):
    """A stage on a motion cube by Thorlabs (K-Cube, T-Cube).

    port: serial port.  microsteps: encoder counts per millimeter or degree.
    """

    port: str

    def open(self, unit: str) -> Stage:
        return ThorlabsStage.open(self.port, self.microsteps, unit)


class StepperMotion(MotionPart):
    """A stepper driven by a computer's hardware PWM, such as a Raspberry Pi's; its position is not measured.

    chip: chip of the PWM, as in /sys/class/pwm.  channel: channel of the PWM.  ramp: acceleration [mm/s2] or [deg/s2].
    """

    reports: ClassVar[bool] = False
    chip: Annotated[int, Field(ge=0)] = 0
    channel: Annotated[int, Field(ge=0)] = 0
    ramp: Annotated[float, Field(gt=0)] = 100.0
    tolerance: Ppm = CRYSTAL

    def open(self, unit: str, pin: int | None = None) -> Stage:
        """See `MotionPart`. pin: input of its index; None without an index."""
        clock = RealClock()
        pulses = stepper.SysfsPwm(self.chip, self.channel)
        index = None if pin is None else GpioIndex.open(pin, clock)
        return stepper.StepperStage(pulses, clock, self.microsteps, unit, self.ramp, index)


class TicMotion(MotionPart):
    """A stepper on Pololu's Tic.  port: serial port, or usb, or usb: and its serial number.  baud: of the port."""

    port: str = "usb"
    baud: Baud = 9600

    def open(self, unit: str) -> Stage:
        return TicStage.open(self.port, self.microsteps, unit, self.baud)


class Tmc2209Motion(MotionPart):
    """A stepper on a TMC2209 at its UART.

    port: serial port.  address: chip address.  microsteps: 256 per full step, per mm or degree.  baud: baud rate.
    """

    port: str
    address: Annotated[int, Field(ge=0, le=3)] = 0
    baud: Baud = 115200

    def open(self, unit: str) -> Stage:
        return Tmc2209Stage.open(self.port, self.microsteps, unit, self.address, self.baud)


class GrblMotion(MotionPart):
    """A stepper on a GRBL 1.1 board, whose mm may be degrees.  port: serial port.  axis: its axis.  baud: baud rate."""

    port: str
    axis: Literal["X", "Y", "Z"] = "X"
    baud: Baud = 115200

    def open(self, unit: str) -> Stage:
        return GrblStage.open(self.port, grbl(self.axis), self.microsteps, unit, self.baud)


class TextMotion(MotionPart):
    """A stepper on a board whose firmware, such as a lab's own on an Arduino or ESP32, takes lines of text.

    Lines may hold {speed} in deg/s or mm/s, {rate} per minute, {steps_per_s}, {position} and {steps}.

    port: serial port.  ask: line that queries the position.  answer: pattern of the answer, with a group ``position``
    or ``steps``.  run: line that starts a motion at a speed.  stop: line that ends it.  move: line that moves to a
    position; by default the axis runs to it.  accepted: pattern of their answer; none by default.  baud: baud rate.
    """

    port: str
    ask: str
    answer: str
    run: str
    stop: str
    move: str = ""
    accepted: str = ""
    baud: Baud = 115200

    @model_validator(mode="after")
    def _readable(self) -> TextMotion:
        try:
            groups = re.compile(f"{self.answer}|{self.accepted}").groupindex
            for line in (self.run, self.stop, self.move):
                if "{" in FIELD.sub("", line):
                    raise ValueError(line)
                line.format(speed=1.0, rate=60.0, steps_per_s=1.0, position=0.0, steps=0)
        except (re.error, ValueError) as error:
            raise ValueError(f"a line or pattern is malformed: {error}; see the fields in hosts/README.md") from error
        if len({"position", "steps"} & set(groups)) != 1:
            raise ValueError("answer has no place; expected a pattern with a group (?P<position>...) or (?P<steps>...)")
        return self

    def open(self, unit: str) -> Stage:
        lines = [f"{line}\n" if line else "" for line in (self.run, self.stop, self.move)]
        says = Dialogue(f"{self.ask}\n", self.answer, *lines, accepted=self.accepted)
        return TextStage.open(self.port, says, self.microsteps, unit, self.baud)


class EmulatedMotion(MotionPart):
    """The emulated motion."""

    emulated: ClassVar[bool] = True
    triggers: ClassVar[bool] = True
    microsteps: Microsteps = 3200.0


class ControllerClock(Part):
    """The controller triggers the mirrors, row by row, by the steps of its own motor."""


class StageClock(Part):
    """The trigger output of the stage triggers the mirrors at every angle."""


class RefreshClock(Part):
    """The projector's vertical blanking; at every refresh, the angle that the stage reports selects the frame."""


class FreeClock(Part):
    """No common clock: projector and motion each run on their own clock, and drift apart."""
