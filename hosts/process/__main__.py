"""The process that holds the light: it reads an order, reports its address, and prints."""

from __future__ import annotations

from pathlib import Path

from vamgpu.errors import DeviceError
from vamgpu.hosts.process.messages import ordered
from vamgpu.hosts.process.order import PrintOrder, printed
from vamgpu.hosts.process.priority import raised
from vamgpu.hosts.process.resume import may_go_on
from vamgpu.hosts.process.service import Service, failed
from vamgpu.hosts.records.state import PrintState

STARTING = 10.0  # time that a print waits for its client to watch [s]


def main() -> None:
    """Print what standard input orders."""
    told, answer = ordered()
    order = PrintOrder.parse(told)
    granted = raised()
    service = Service(order)
    answer(service.live)
    end = failed(DeviceError("the process that holds the light ended early"))
    try:
        if not service.seen.wait(STARTING):
            raise DeviceError("the client does not watch this print; nothing was lit: print again")
        planned = order.planned()
        if order.resume:
            may_go_on(planned, order.folder)
        stand = order.stand(planned, paced=True) if planned.rehearsed else None
        asked = None if order.page else (lambda job: order.asks and service.go_on(job.sense))
        end = printed(
            order, planned, stand, service.board, told=service.facts.__setitem__, go_on=asked, process=granted
        )
    except BaseException as error:
        end = failed(error)
        if isinstance(error, SystemExit):  # a signal, after which the print is cancelled
            end = {"state": PrintState.CANCELLED.value} if Path(order.folder).is_dir() else end
    finally:
        service.close(end)


if __name__ == "__main__":
    main()
