"""Clocks: parts that decide when a frame comes."""

from __future__ import annotations

from vamgpu.hosts.rigs.roles import Part


class ControllerClock(Part):
    """The controller triggers the mirrors, row by row, by the steps of its own motor."""


class StageClock(Part):
    """The stage's trigger output triggers the mirrors at every pose."""


class RefreshClock(Part):
    """The projector's vertical blanking; the angle that the stage says chooses the frame of every refresh."""


class FreeClock(Part):
    """Nobody: projector and motion each follow a clock of their own, and drift apart."""
