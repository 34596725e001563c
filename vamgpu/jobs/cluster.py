"""Tasks that do not need each other, here one after the other or on the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import vamgpu
from vamgpu.errors import BadInput, DeviceError

Item = TypeVar("Item")
Found = TypeVar("Found")
TRIES = 100
"""How often a task is begun anew whose worker died."""
PATIENCE = 60.0
"""Seconds that workers get to come up."""


@contextmanager
def workers(where: str | None, device: str | None = None) -> Iterator[Callable[..., Iterator[Any]]]:
    """A function that carries out tasks, and the workers behind it.

    A worker that dies costs the task it was at, which another one does again.

    Args:
        where: ``local:4`` for four processes of this machine, ``tcp://host:8786`` for the scheduler of a cluster that
            runs, or None for this process.
        device: That every worker must have; None takes the best one of each.

    Yields:
        A function of a function and a sequence of its arguments, which gives results as they come. Both, and what is
        found, travel to other processes and back.

    Raises:
        BadInput: ``where`` is no such address.
        DeviceError: Dask is not installed, no cluster answers, or a worker has another version or not the device; the
            message names it.
    """
    if where is None:
        yield lambda function, items: map(function, items)
        return
    client = _client(where)
    try:
        _refuse_unlike(client, device)
        yield lambda function, items: _results(client, function, items)
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
    processes: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    try:
        if not local:
            return Client(where, timeout=PATIENCE)
        with dask.config.set({"distributed.scheduler.allowed-failures": TRIES}):
            return Client(LocalCluster(n_workers=int(rest), **processes), timeout=PATIENCE)
    except (OSError, TimeoutError, ValueError) as error:
        raise DeviceError(f"no cluster answers at {where!r}: {error}; start its scheduler, or take local:4") from error


def about(device: str | None) -> tuple[str, str]:
    """What a worker is asked: its version of the library, and why it does not have the device, or nothing.

    Args:
        device: By name; None for any.

    Returns:
        Version and complaint.
    """
    try:
        vamgpu.open_device(device)
    except DeviceError as error:
        return vamgpu.__version__, str(error)
    return vamgpu.__version__, ""


def _refuse_unlike(client: Any, device: str | None) -> None:
    client.wait_for_workers(1, timeout=PATIENCE)
    for worker, (version, complaint) in client.run(about, device).items():
        if version != vamgpu.__version__:
            raise DeviceError(
                f"worker {worker} has vamgpu {version}, and this is {vamgpu.__version__}: install the same on both"
            )
        if complaint:
            raise DeviceError(f"worker {worker} cannot compute: {complaint}")


def _results(client: Any, function: Callable[[Item], Found], items: Sequence[Item]) -> Iterator[Found]:
    from distributed import as_completed

    futures = client.map(function, items, pure=False, retries=TRIES)
    try:
        for _, found in as_completed(futures, with_results=True):
            yield found
    finally:
        client.cancel(futures)
