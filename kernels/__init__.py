"""Kernels: one concept per file, in three versions."""
