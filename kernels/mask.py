"""Columns of frames, or rays of light, that are kept; the others become dark."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import pointwise
from vamgpu.kernels.signature import Sinogram, SinogramOut, Table, kernel

Bytes = Annotated[np.ndarray, Table("uint8", ("angle", "z", "byte"))]
BytesOut = Annotated[np.ndarray, Table("uint8", ("angle", "z", "byte"), writes=True)]
Row = Annotated[np.ndarray, Table("uint8", ("byte",))]
Shares = Annotated[np.ndarray, Table("float32", ("r",))]


@kernel(over="masked")
def mask_bytes(images: Bytes, mask: Row, masked: BytesOut) -> None:
    """masked = images AND mask, bitwise and the same for every row: at 1 bit a byte holds eight columns."""
    masked[...] = images & mask


@pointwise(over="masked")
def mask_rays(light: Sinogram, shares: Shares, masked: SinogramOut) -> None:
    """masked = light · shares[r]; masked may be light."""
    masked[...] = light * shares[None, :, None]
