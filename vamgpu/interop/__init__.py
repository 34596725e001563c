"""Operators, doses and kinetics as differentiable functions of other libraries: see `.torch` and `.jax`."""

from vamgpu.interop.functions import Differentiable, function_of
from vamgpu.interop.proof import ProofDose

__all__ = ["Differentiable", "ProofDose", "function_of"]
