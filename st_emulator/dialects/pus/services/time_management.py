"""ST[09] time: its setting, and reports of it with the frames."""

from __future__ import annotations

from ....device.commands import SetTime, modes_of
from ....device.star_tracker import StarTracker
from ....protocol.pus.packets import CucTime
from ..serving import ANY, Execute, Served, command
from ..time_code import cuc_at, time_status
from ..verification import Request, Send


class TimeManagement:
    """Sets the on-board time and reports it each 2^n-th frame."""

    def __init__(self, device: StarTracker, send: Send) -> None:
        self._device = device
        self._send = send
        self._rate_exponent: int | None = None

    def reset(self) -> None:
        """As after power-on: no time reports."""
        self._rate_exponent = None

    def frame_started(self, frame_index: int) -> None:
        """Report, if it is this frame's turn."""
        exponent = self._rate_exponent
        if exponent is not None and frame_index % (1 << exponent) == 0:
            fields = {
                "rate_exponent": exponent,
                "time": cuc_at(self._device, self._device.clock.now_ns),
                "time_status": int(time_status(self._device)),
            }
            self._send("time_report", fields)

    def report_rate(self, request: Request) -> Execute:
        def execute() -> None:
            self._rate_exponent = request.fields["rate_exponent"]
            request.completed()

        return execute

    def set(self, request: Request) -> Execute:
        time: CucTime = request.fields["time"]
        return command(self._device, SetTime(time.to_ns(), request.received_ns), request)


SERVED = {
    "time_report_rate": Served(ANY, TimeManagement.report_rate),
    "set_time": Served(modes_of(SetTime), TimeManagement.set),
}
