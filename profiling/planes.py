"""Bit planes of 8-bit pictures, on devices and with NumPy, in batches that no cache holds any more.

    python profiling/planes.py --devices cpu
    python profiling/planes.py --devices opencl:nvidia:0 warp:cuda:0 --out planes.json

``single``: one batch on the device and a picture by every peer, in turns; what a print sees, whose threads slept
before.  ``repeated``: eight batches in a row, then the peers; what a device sustains.

The peers have one thread, as NumPy has: ``packbits`` takes each bit by a mask and packs it, ``shifted`` shifts it down
first, ``turned`` turns 8 × 8 bits in long words, ``same_work`` is ``packbits`` after the columns' masks, with the sum
of the levels. What counts is the ratio to the fastest, which does less work than the device.

``copy``: as many bytes copied, that no cache holds either, by two threads on processors and by the device's own means
on GPUs; ``share`` is the rate of splitting over it, bytes of pictures and planes counted once.  ``read_ms``: a
picture's planes brought to the print's buffers.  ``borrowed_ms``: split right into them, on processors.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from common import chosen_devices, is_gpu, machine, write_record

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.hosts.frames.buffers import pinned_buffers
from vamgpu.kernels.planes import split_planes, strips_for

BATCH, ROTATION = 8, 3
MASKS = 1 << np.arange(7, -1, -1, dtype=np.uint8)
TURNS = ((7, 0x00AA00AA00AA00AA), (14, 0x0000CCCC0000CCCC), (28, 0x00000000F0F0F0F0))


class Peers:
    """Ways to split a picture with NumPy into planes of so many bytes a row."""

    def __init__(self, rows: int, columns: int) -> None:
        self._levels, self._masked = np.empty((2, rows, columns), np.uint8)
        self._needed, self._mask = columns // 8, np.full(columns, 255, np.uint8)
        self._word, self._other = np.empty((2, 120, self._needed), np.uint64)

    def packbits(self, picture: np.ndarray, out: np.ndarray) -> None:
        for plane, mask in enumerate(MASKS):
            np.bitwise_and(picture, mask, out=self._levels)
            packed = np.packbits(self._levels.reshape(-1))
            out[plane, :, : self._needed] = packed.reshape(len(picture), -1)

    def shifted(self, picture: np.ndarray, out: np.ndarray) -> None:
        for plane in range(8):
            out[plane, :, : self._needed] = np.packbits((picture >> (7 - plane)) & 1, axis=-1)

    def turned(self, picture: np.ndarray, out: np.ndarray) -> None:
        for top in range(0, len(picture), 120):
            rows = slice(top, min(top + 120, len(picture)))
            word, other = (each[: rows.stop - top] for each in (self._word, self._other))
            np.copyto(word, picture[rows].view(np.uint64))
            word.byteswap(inplace=True)
            for shift, mask in TURNS:
                np.right_shift(word, np.uint64(shift), out=other)
                other ^= word
                other &= np.uint64(mask)
                word ^= other
                np.left_shift(other, np.uint64(shift), out=other)
                word ^= other
            planes = word.view(np.uint8).reshape(*word.shape, 8)
            for plane in range(8):
                out[plane, rows, : self._needed] = planes[:, :, 7 - plane]

    def same_work(self, picture: np.ndarray, out: np.ndarray) -> None:
        np.bitwise_and(picture, self._mask, out=self._masked)
        self._masked.sum(dtype=np.int64)
        self.packbits(self._masked, out)

    def all(self) -> dict[str, Callable[[np.ndarray, np.ndarray], None]]:
        return {name: getattr(self, name) for name in ("packbits", "shifted", "turned", "same_work")}


class Splitter:
    """A device that splits batches in turn into one of several buffers."""

    def __init__(self, device: Device, pictures: np.ndarray, width: int) -> None:
        count, rows, columns = pictures.shape
        self._device, self._count, self.shape = device, count // BATCH, (BATCH, 8, rows, width)
        strips = strips_for(rows, width, is_gpu(device))
        self._tables = {
            "images": device.upload(pictures, table=True),
            "masks": device.upload(np.full((1, columns), 255, np.uint8), table=True),
            "sent": device.empty((BATCH, strips), np.int32, table=True),
        }
        first = np.stack([np.arange(BATCH), np.zeros(BATCH)], axis=1).astype(np.int32)
        self._chosen = [device.upload(first + [BATCH * k, 0], np.int32, table=True) for k in range(self._count)]
        self.outs = [device.empty(self.shape, np.uint8, table=True) for _ in range(ROTATION)]

    def launch(self, turn: int, outs: list[DeviceArray] | None = None) -> DeviceArray:
        out = (outs or self.outs)[turn % ROTATION]
        chosen = self._chosen[turn % self._count]
        self._device.launch(split_planes, **self._tables, chosen=chosen, top=0, left=0, packed=out)
        return out

    def check(self, pictures: np.ndarray) -> None:
        """Raises AssertionError where planes or sums are wrong."""
        for turn in range(self._count):
            planes = self.launch(turn).numpy()[..., : pictures.shape[2] // 8]
            own = pictures[BATCH * turn : BATCH * (turn + 1)]
            for plane, mask in enumerate(MASKS):
                assert np.array_equal(planes[:, plane], np.packbits(own & mask, axis=-1)), f"plane {plane}"
            assert np.array_equal(self._tables["sent"].numpy().sum(axis=1), own.sum(axis=(1, 2), dtype=np.int64))


def seconds(run: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


def spread(times: list[float]) -> dict[str, Any]:
    """Of times [s]: median, quartiles and least [ms]."""
    low, middle, high = (1e3 * float(q) for q in np.percentile(times, [25, 50, 75]))
    return {"median_ms": round(middle, 5), "quartiles_ms": [round(low, 5), round(high, 5)],
            "least_ms": round(1e3 * min(times), 5)}  # fmt: skip


def alternately(device: Device, splitter: Splitter, pictures: np.ndarray, row: int, runs: int) -> dict[str, Any]:
    """Times a picture of the device, in runs of so many batches, and of every peer, taken in turns."""
    out = np.zeros((BATCH, *splitter.shape[1:]), np.uint8)
    peers = Peers(*pictures.shape[1:]).all()
    times: dict[str, list[float]] = {name: [] for name in ("device", *peers)}
    turn = 0

    def batches() -> None:
        nonlocal turn
        for _ in range(row):
            splitter.launch(turn)
            turn += 1
        device.synchronize()

    for run in range(runs + 3):
        times["device"].append(seconds(batches) / (row * BATCH))
        for k, (name, peer) in enumerate(peers.items()):
            picture = pictures[(7 * run + 5 * k) % len(pictures)]
            times[name].append(seconds(lambda peer=peer, picture=picture, k=k: peer(picture, out[k])))
    found: dict[str, Any] = {name: spread(each[3:]) for name, each in times.items()}
    best = min(peers, key=lambda name: found[name]["median_ms"])
    own = found["device"]["median_ms"]
    found["fastest_peer"] = best
    found["ratio"] = {name: round(found[name]["median_ms"] / own, 2) for name in (best, *peers)}
    return found


def copying(device: Device, nbytes: int, runs: int) -> float:
    """Bytes read and written a second, GB/s, by copies of so many, in turn from and to several places."""
    if not is_gpu(device):
        places = np.ones((4, 2, 2, nbytes // 2), np.uint8)
        with ThreadPoolExecutor(2) as threads:
            times = [seconds(lambda k=k: list(threads.map(np.copyto, *places[k % 4]))) for k in range(runs)]
        return 2e-9 * nbytes / float(np.median(times[4:]))
    values = np.ones(nbytes, np.uint8)
    pairs: list[Any] = [[device.upload(values, table=True).handle for _ in range(2)] for _ in range(4)]
    queue = getattr(device, "queue", None)
    times = [seconds(lambda k=k: (_copy(queue, *pairs[k % 4]), device.synchronize())) for k in range(runs)]
    return 2e-9 * nbytes / float(np.median(times[4:]))


def _copy(queue: Any, target: Any, source: Any) -> None:
    if queue is None:
        import warp as wp

        wp.copy(target, source)
    else:
        import pyopencl as cl

        cl.enqueue_copy(queue, target, source)


def to_the_host(device: Device, splitter: Splitter, runs: int) -> dict[str, Any]:
    """Milliseconds a picture: planes split before read into buffers of a print, and split right into them."""
    ring = pinned_buffers(ROTATION, splitter.shape, device)
    found: dict[str, Any] = {"pinned": is_gpu(device)}
    device.synchronize()
    times = [seconds(lambda k=k: splitter.outs[k % ROTATION].numpy(ring[k % ROTATION])) for k in range(runs)]
    found["read_ms"] = spread([each / BATCH for each in times[2:]])
    if not is_gpu(device):
        borrowed = [device.borrow(array) for array in ring]
        times = [seconds(lambda k=k: (splitter.launch(k, borrowed), device.synchronize())) for k in range(runs)]
        found["borrowed_ms"] = spread([each / BATCH for each in times[2:]])
    return found


def measure(device: Device, pictures: np.ndarray, width: int, runs: int) -> dict[str, Any]:
    splitter = Splitter(device, pictures, width)
    splitter.check(pictures)
    each = pictures[0].nbytes + 8 * pictures.shape[1] * width
    record: dict[str, Any] = {"bytes_a_picture": each}
    record["copy_before_gb_s"] = round(copying(device, BATCH * each // 2, 20), 2)
    record["single"] = alternately(device, splitter, pictures, 1, runs)
    record["repeated"] = alternately(device, splitter, pictures, 8, runs)
    record["copy_after_gb_s"] = round(copying(device, BATCH * each // 2, 20), 2)
    copy = max(record["copy_before_gb_s"], record["copy_after_gb_s"])
    for way in ("single", "repeated"):
        rate = 1e-6 * each / record[way]["device"]["median_ms"]
        record[way] |= {"gb_s": round(rate, 2), "share_of_copy": round(rate / copy, 3)}
    return record | to_the_host(device, splitter, 12)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", nargs="+", default=["cpu"])
    parser.add_argument("--size", type=int, nargs=2, default=(1080, 1920), metavar=("ROWS", "COLUMNS"))
    parser.add_argument("--row-bytes", type=int, default=256, help="of a plane, a multiple of 8")
    parser.add_argument("--pictures", type=int, default=32, help="on the device, a multiple of 8")
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--out", type=Path, default=None, help="file for the record; it is printed anyway")
    asked = parser.parse_args()
    shape = (asked.pictures // BATCH * BATCH, *asked.size)
    pictures = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    devices = chosen_devices(asked.devices)
    size = {"pictures": shape, "row_bytes": asked.row_bytes, "batch": BATCH, "runs": asked.runs}
    record = {"size": size, "machine": machine(*devices), "devices": {}}
    for device in devices:
        found = record["devices"][device.name] = measure(device, pictures, asked.row_bytes, asked.runs)
        for way in ("single", "repeated"):
            best = found[way]["fastest_peer"]
            print(f"{device.name} {way}: {found[way]['device']['median_ms']:.4f} ms a picture, {best} "
                  f"{found[way][best]['median_ms']:.3f} ms, {found[way]['ratio'][best]}x; {found[way]['gb_s']} GB/s, "
                  f"{found[way]['share_of_copy']} of a copy", flush=True)  # fmt: skip
        own = {name: found[name]["median_ms"] for name in ("read_ms", "borrowed_ms") if name in found}
        print(f"{device.name}: to the host {own}, pinned: {found['pinned']}", flush=True)
    if asked.out:
        print(write_record(asked.out.parent, asked.out.stem, record))
    return 0


if __name__ == "__main__":
    sys.exit(main())
