"""Independent tasks, run one after another in this process or on the workers of a Dask cluster."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

import vamgpu
from vamgpu.backend.remote import RemoteDevice, Served
from vamgpu.backend.slabs import SlabDevice
from vamgpu.errors import BadInput, DeviceError, VamError, WorkerLost

Item = TypeVar("Item")
Found = TypeVar("Found")
START = """
import os, signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
def dask_setup(worker):
    gpus = {gpus}
    if gpus:
        os.environ["CUDA_VISIBLE_DEVICES"] = gpus[worker.name % len(gpus)]
"""
"""Start of local workers: Ctrl-C in a terminal also reaches them, but they must still return the plan. Each sees one of
the GPUs, in turn."""
GPUS = "/proc/driver/nvidia/gpus"
TRIES = 100  # number of times that a task restarts after its worker died
AHEAD = 3  # tasks per worker that start before the first result is read, if results are read in order
LOOK = 5.0  # time after which a silent worker is checked [s]
RETURN = 5.0  # time for a lost worker to return before another worker takes its slab [s]
PATIENCE = 60.0  # time for workers to start [s]


@contextmanager
def workers(where: str | None, device: str | None = None) -> Iterator[Callable[..., Iterator[Any]]]:
    """A function that runs tasks, and its workers. Raises `BadInput`, `DeviceError`."""
    if where is None:
        yield lambda function, items, ordered=False: map(function, items)  # noqa: ARG005 - they come in order
        return
    with _alike(where, device) as client:
        yield lambda function, items, ordered=False: _results(client, function, items, ordered=ordered)


@contextmanager
def _alike(where: str, device: str | None) -> Iterator[Any]:
    """A client of workers that have this version of the library, and the device."""
    if where.startswith("local:") and re.search("(cuda|nvidia):0*[1-9]", (device or "").lower()) and _visible_gpus():
        raise DeviceError(
            f"got {device!r} for workers that see one GPU each, number 0; expected a name with 0, or gpu: "
            "CUDA_VISIBLE_DEVICES chooses the GPUs that they take in turn"
        )
    client = _client(where)
    try:
        _refuse_unlike(client, device)
        yield client
    finally:
        client.close()
        if client.cluster is not None:
            client.cluster.close()


def _client(where: str) -> Any:
    kind, _, rest = where.partition(":")
    local = kind == "local" and rest.isdecimal() and 0 < int(rest) <= 1024
    if not local and kind not in ("tcp", "tls"):
        raise BadInput(f"got {where!r} for a cluster; expected local:4 for four processes, or tcp://host:8786")
    try:
        import dask.config
        from distributed import Client, LocalCluster
    except ModuleNotFoundError as error:
        raise DeviceError(f"a cluster needs Dask ({error}): pip install 'vamgpu[cluster]'") from error
    processes: dict[str, Any] = {
        "threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": 50,
        "preload": [START.format(gpus=_visible_gpus())],
    }  # fmt: skip
    try:
        if not local:
            return Client(where, timeout=PATIENCE)
        with dask.config.set({"distributed.scheduler.allowed-failures": TRIES}):
            return Client(LocalCluster(n_workers=int(rest), **processes), timeout=PATIENCE)
    except (OSError, TimeoutError, ValueError) as error:
        raise DeviceError(f"no cluster answers at {where!r}: {error}; start its scheduler, or use local:4") from error


def _visible_gpus() -> list[str]:
    """NVIDIA's GPUs that this process may use, as in CUDA_VISIBLE_DEVICES."""
    listed = os.environ.get("CUDA_VISIBLE_DEVICES")
    if listed is None:
        return [str(number) for number in range(len(os.listdir(GPUS)))] if os.path.isdir(GPUS) else []
    return [each.strip() for each in listed.split(",") if each.strip()]


@contextmanager
def slabs(where: str, device: str | None = None) -> Iterator[Callable[[], SlabDevice]]:
    """The workers of a cluster as one device, which divides every field along z; see `vamgpu.backend.slabs`."""
    with _alike(where, device) as client:
        count = len(client.nthreads())

        def made() -> SlabDevice:
            members = [_remote(client, device, number, count) for number in range(count)]
            kinds = dict.fromkeys(member.kind for member in members)
            return SlabDevice(f"{' and '.join(kinds)} on {where}", members)

        yield made


def _remote(client: Any, device: str | None, number: int, count: int) -> RemoteDevice:
    """A device of a worker, one of ``count``; a device of another worker if fewer are left. Raises `WorkerLost`."""
    until = time.monotonic() + PATIENCE
    while True:
        try:
            left = sorted(client.nthreads())
            if len(left) < count and time.monotonic() < until - PATIENCE + RETURN:
                time.sleep(0.1)  # a worker that restarts takes a moment
                continue
            client.wait_for_workers(1, timeout=PATIENCE)
            left = sorted(client.nthreads())
            where = [left[number % len(left)]]
            future = client.submit(Served, device, actor=True, workers=where, pure=False, allow_other_workers=False)
            actor = future.result(timeout=PATIENCE)
            facts = actor.facts().result(timeout=PATIENCE)
            break
        except VamError:
            raise
        except Exception as error:  # noqa: BLE001 - a worker that dies breaks whatever is under way
            late = time.monotonic() >= until
            if late and client.status != "running":
                raise DeviceError("the scheduler has stopped; restart it, and run the command again") from error
            if late and not client.nthreads():
                raise DeviceError("no worker is left; start some, and run the same command to continue") from error
            if late:
                raise WorkerLost(f"no worker takes slab {number}: {type(error).__name__}: {error}") from error

    def send(orders: list[Any]) -> list[Any]:
        try:
            answers = actor.act(orders)
            while True:
                with suppress(TimeoutError):
                    return answers.result(timeout=LOOK)
                if future.status not in ("finished", "pending") or where[0] not in client.nthreads():
                    raise WorkerLost(f"the worker {where[0]} is lost")
        except VamError:
            raise
        except Exception as error:  # noqa: BLE001 - as above
            raise WorkerLost(f"the worker {where[0]} is lost: {type(error).__name__}: {error}") from error

    return RemoteDevice(f"slab {number} at {where[0]}", facts, send)


def about(device: str | None) -> tuple[str, str]:
    """A worker's version of the library, and the reason if it lacks the device ("" if it has it)."""
    try:
        vamgpu.open_device(device)
    except DeviceError as error:
        return vamgpu.__version__, str(error)
    return vamgpu.__version__, ""


def _refuse_unlike(client: Any, device: str | None) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
        answers = client.run(about, device)
    except TimeoutError as error:
        raise DeviceError(
            f"the cluster has no worker after {PATIENCE:g} s: start some: `dask worker tcp://…`"
        ) from error
    except ImportError as error:
        raise DeviceError(f"a worker lacks a package ({error}): install the packages of this process") from error
    for worker, (version, complaint) in answers.items():
        if version != vamgpu.__version__:
            raise DeviceError(
                f"worker {worker} has vamgpu {version}, this process {vamgpu.__version__}: install the same"
            )
        if complaint:
            raise DeviceError(f"worker {worker} cannot compute: {complaint}")


def _results(
    client: Any, function: Callable[[Item], Found], items: Sequence[Item], *, ordered: bool = False
) -> Iterator[Found]:
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    numbers: dict[Any, int] = {}
    deaths, waiting, first, begun = [0] * len(items), dict[int, Found](), 0, 0
    done = as_completed()

    def begin(number: int) -> None:
        future = client.submit(function, items[number], pure=False)
        numbers[future] = number
        done.add(future)

    try:
        while numbers or begun < len(items):
            most = first + AHEAD * max(len(client.nthreads()), 1) if ordered else len(items)
            while begun < min(most, len(items)):
                begin(begun)
                begun += 1
            future = next(done)
            number = numbers.pop(future)
            try:
                found = future.result()
            except KilledWorker:  # a scheduler that another process started allows fewer deaths
                deaths[number] += 1
                if deaths[number] > TRIES:
                    raise
                begin(number)
                continue
            del future
            if not ordered:
                yield found
                continue
            waiting[number] = found
            while first in waiting:
                yield waiting.pop(first)
                first += 1
    finally:
        if client.status == "running":
            client.cancel(list(numbers))
