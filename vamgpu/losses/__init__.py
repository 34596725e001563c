"""Losses of a dose: small objects with a value and a gradient, which combine with weights and responses."""

from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss, Mean
from vamgpu.losses.ramp import Ramp
from vamgpu.losses.response import GeneralizedLogistic, Interpolated, Linear, Logistic, Response
from vamgpu.losses.voxel_loss import VoxelLoss, cross_entropy

__all__ = [
    "Band",
    "GeneralizedLogistic",
    "Interpolated",
    "Linear",
    "Logistic",
    "Loss",
    "Mean",
    "Ramp",
    "Response",
    "VoxelLoss",
    "cross_entropy",
]
