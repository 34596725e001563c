"""Kernels: one concept per file, in three versions.

``concept.py`` is the NumPy definition in float64 and declares the signature; ``concept.cl`` and ``concept_warp.py``
compute the same on OpenCL devices and through Warp. `vamgpu.kernels.signature` explains the declarations.
"""
