"""Images of cameras and patterns; their size is checked before they are decoded."""

from __future__ import annotations

import struct
import zlib
from contextlib import redirect_stdout
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np

from vamgpu.errors import StorageError
from vamgpu.storage.reading import read_bytes

MOST_BYTES = 1 << 30
MOST_PIXELS = 1 << 28  # limit of pixels: larger cameras are not used on printers
SIGNATURE = b"\x89PNG\r\n\x1a\n"
UP = 2  # PNG's filter of differences from the row above: most rows of a slice are like the previous one


def read_image(path: str | Path) -> np.ndarray:
    """The gray levels of an image file without colors."""
    from PIL import Image, UnidentifiedImageError

    data = read_bytes(path, MOST_BYTES)
    try:
        with Image.open(BytesIO(data), formats=("PNG", "TIFF", "JPEG", "BMP")) as image:
            if image.width * image.height > MOST_PIXELS:
                raise OSError(f"{image.width} × {image.height} pixels, expected {MOST_PIXELS:,} in all at most")
            if image.mode in ("1", "L", "I;16", "I;16B", "I", "F"):
                return np.asarray(image.convert("L") if image.mode == "1" else image)
            red, green, blue = image.convert("RGB").split()
            if not red == green == blue:
                raise OSError("it has colors, whose light is unknown, expected gray levels: convert it to gray")
            return np.asarray(red)
    except UnidentifiedImageError as error:
        raise OSError("it is none of PNG, TIFF, JPEG and BMP") from error
    except OSError:
        raise
    except Exception as error:  # for damaged files, readers raise many types of errors
        raise OSError(f"{type(error).__name__}: {error}") from error


def read_exr(path: str | Path) -> np.ndarray:
    """The light of an OpenEXR image: its channel Y, its only one, or the mean of red, green and blue."""
    try:
        import OpenEXR
    except ImportError as error:
        raise StorageError(f'{str(path)!r} is read by the package OpenEXR: pip install "vamgpu[exr]"') from error
    data = read_bytes(path, MOST_BYTES)
    try:
        head = OpenEXR.File(BytesIO(data), separate_channels=True, header_only=True).header()
        (left, top), (right, bottom) = head["dataWindow"]
        count = (int(right) - int(left) + 1) * (int(bottom) - int(top) + 1)
        if not 0 < count * len(head["channels"]) <= MOST_PIXELS:
            raise OSError(f"{count:,} pixels, expected {MOST_PIXELS:,} in all channels at most")
        with redirect_stdout(StringIO()):  # its warnings
            found = OpenEXR.File(BytesIO(data), separate_channels=True, num_threads=0).channels()
        planes = {name: np.asarray(channel.pixels, np.float32) for name, channel in found.items()}
    except OSError:
        raise
    except Exception as error:  # its reader raises many types of errors
        raise OSError(f"{type(error).__name__}: {error}") from error
    if "Y" in planes or len(planes) == 1:
        return planes.get("Y", next(iter(planes.values())))
    if not {"R", "G", "B"} <= set(planes):
        raise OSError(f"it has the channels {', '.join(planes)}; expected Y, or R, G and B")
    return (planes["R"] + planes["G"] + planes["B"]) / np.float32(3.0)


def write_exr(path: str | Path, light: np.ndarray) -> None:
    """Write light as an OpenEXR image of one channel, Y."""
    try:
        import OpenEXR
    except ImportError as error:
        raise StorageError('EXR images are written by the package OpenEXR: pip install "vamgpu[exr]"') from error
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        OpenEXR.File(head, {"Y": OpenEXR.Channel(np.ascontiguousarray(light, np.float32))}).write(str(path))
    except Exception as error:  # its writer raises errors of its own
        raise OSError(f"{type(error).__name__}: {error}") from error


def encode_png(levels: np.ndarray) -> bytes:
    """A PNG of levels: bool [y, x] with 1 bit a pixel, uint8 [y, x] in gray or uint8 [y, x, color]."""
    rows, columns = levels.shape[:2]
    packed = np.packbits(levels, axis=1) if levels.dtype == bool else levels.reshape(rows, -1)
    lines = np.zeros((rows, packed.shape[1] + 1), np.uint8)
    if levels.dtype == np.uint8 and levels.ndim == 2:
        lines[:, 0], lines[0, 1:] = UP, levels[0]
        np.subtract(levels[1:], levels[:-1], out=lines[1:, 1:])
    else:
        lines[:, 1:] = packed
    head = struct.pack(">IIBBBBB", columns, rows, 1 if levels.dtype == bool else 8, 2 * (levels.ndim == 3), 0, 0, 0)
    return SIGNATURE + _chunk(b"IHDR", head) + _chunk(b"IDAT", deflated(lines)) + _chunk(b"IEND", b"")


def deflated(data: np.ndarray) -> bytes:
    """Contiguous bytes, packed as runs of equal bytes: for differences this is smaller and faster than a search."""
    packer = zlib.compressobj(1, strategy=zlib.Z_RLE)
    return packer.compress(data) + packer.flush()  # type: ignore[arg-type]


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
