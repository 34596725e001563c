"""Kernels: one concept a file, three siblings each.

``concept.py`` is the NumPy definition in float64 and declares the signature; ``concept.cl`` and ``concept_warp.py``
compute the same thing on OpenCL devices and through Warp. `vamgpu.kernels.signature` says how a declaration reads.
"""
