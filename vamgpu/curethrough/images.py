"""Slices as files: properties of a picture, its bytes, and fast writing of 8-bit pictures."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO

import numpy as np

from vamgpu.errors import SliceError
from vamgpu.storage.images import SIGNATURE, encode_png

DEEP = ("I", "F", "I;16", "I;16B", "I;16L", "I;16N")
COLORS = {0: "gray", 2: "color", 3: "palette", 4: "gray with alpha", 6: "color with alpha"}
HEAD = 33  # number of bytes of a PNG that contain its properties
MOST_PIXELS = 1 << 27


@dataclass(frozen=True)
class Header:
    """Pixels along y and x, and the kind of pixels in words."""

    shape: tuple[int, int]
    kind: str


def header(data: bytes, name: str) -> Header:
    """Read shape and kind from the first `HEAD` bytes of a PNG, or from a whole TIFF. Raises `SliceError`."""
    if data.startswith(SIGNATURE):
        if len(data) < HEAD or data[12:16] != b"IHDR":
            raise SliceError(f"{name} is cut off after {len(data)} bytes; copy or export it again")
        width, height, bits, color = struct.unpack(">IIBB", data[16:26])
        return _promised(Header((height, width), f"{bits}-bit {COLORS.get(color, 'unknown')}"), bits, name)
    from PIL import Image

    try:
        with Image.open(BytesIO(data), formats=("TIFF",)) as image:
            width, height, mode, pages = *image.size, image.mode, getattr(image, "n_frames", 1)
    except Exception as error:  # noqa: BLE001 - damaged files raise whatever their reader stumbles over
        raise _damaged(name, error) from error
    if pages != 1:
        raise SliceError(f"{name} holds {pages} pages; expected one slice per file: split it")
    bits = 1 if mode == "1" else 16 if mode in DEEP else 8
    return _promised(Header((height, width), f"{bits}-bit {'gray' if mode in ('1', 'L') else mode}"), bits, name)


def _promised(found: Header, bits: int, name: str) -> Header:
    if bits > 8:
        raise SliceError(f"{name} has {bits} bits per pixel; expected 8: export the slices again with 8 bits")
    if min(found.shape) < 1 or found.shape[0] * found.shape[1] > MOST_PIXELS:
        size = f"{found.shape[1]} × {found.shape[0]}"
        raise SliceError(f"{name} is {size} pixels; expected 1 to {MOST_PIXELS:,} in all: check the file")
    return found


def decode(data: bytes, name: str, out: np.ndarray) -> None:
    """Write gray levels of a picture into uint8 ``out`` [y, x]; 1 bit becomes 0 and 255. Raises `SliceError`."""
    from PIL import Image

    if data.startswith(SIGNATURE):
        _check_whole(data, name)
    else:
        header(data, name)
    try:
        with Image.open(BytesIO(data), formats=("PNG", "TIFF")) as image:
            plain = image if image.mode in ("L", "1") else image.convert("RGBA")
            values = np.asarray(plain.convert("L") if plain.mode == "1" else plain)
    except Exception as error:  # noqa: BLE001 - as above
        raise _damaged(name, error) from error
    if values.ndim == 3:
        values = _gray(values, name)
    if values.shape != out.shape:
        raise SliceError(
            f"{name} is {values.shape[1]} × {values.shape[0]} pixels, others are {out.shape[1]} × {out.shape[0]}; "
            "expected one size: export the slices again"
        )
    out[...] = values


def _gray(values: np.ndarray, name: str) -> np.ndarray:
    if (values[..., 0] != values[..., 1]).any() or (values[..., 0] != values[..., 2]).any():
        raise SliceError(f"{name} is colored; expected shades of gray: export the slices as 8-bit gray")
    if (values[..., 3] != 255).any():
        raise SliceError(f"{name} is partly transparent; expected plain gray: export the slices as 8-bit gray")
    return values[..., 0]


def _check_whole(data: bytes, name: str) -> None:
    """Check the check sum of every chunk of a PNG up to its end, because picture readers tolerate errors."""
    at, size = len(SIGNATURE), len(data)
    view = memoryview(data)
    while at + 12 <= size:
        length = int.from_bytes(data[at : at + 4], "big")
        end = at + 12 + length
        if end > size:
            break
        if zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise SliceError(f"{name} is damaged: its check sum is wrong at byte {at}; copy or export it again")
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end
    raise SliceError(f"{name} is cut off after {size} bytes; copy or export it again")


def _damaged(name: str, error: Exception) -> SliceError:
    said = str(error) if "BytesIO" not in str(error) else "it is neither PNG nor TIFF"
    return SliceError(f"{name} cannot be read: {said}; copy or export it again")


def encode(levels: np.ndarray, ending: str) -> bytes:
    """The bytes of gray levels, uint8 [y, x], as a file ending in .png, .tif or .tiff."""
    if ending.lower() == ".png":
        return encode_png(levels)
    import tifffile

    stream = BytesIO()
    tifffile.imwrite(stream, levels, photometric="minisblack", compression="zlib", compressionargs={"level": 1})
    return stream.getvalue()
