"""A captured image over ISO-TP on the modelled bus, in virtual time, while the unit tracks."""

from __future__ import annotations

from typing import Any

from ideal_obc import IdealObc
from running_unit import SCENARIO

from st_emulator.bench.scenario import parse_scenario
from st_emulator.clock import NS_PER_S
from st_emulator.protocol.pus.enumerations import FunctionId
from st_emulator.units.profile import load_unit

WARM_UP_S = 5
PARTS = ("image_first_part", "image_part", "image_last_part")


def measure(unit: str) -> dict[str, Any]:
    """Payload of the image per second against consecutive frames back to back, which the bus could carry."""
    obc = IdealObc(load_unit(unit), parse_scenario(SCENARIO, "bench"))
    obc.run_to(WARM_UP_S * NS_PER_S)
    obc.send("function", function_id=FunctionId.CAPTURE_IMAGE, arguments={})
    obc.run_to(obc.now_ns + NS_PER_S)
    begun, sent = len(obc.packets), len(obc.consecutive)
    arguments = {"transaction_id": 1, "first_part": 0, "parts": 0}
    obc.send("function", function_id=FunctionId.DOWNLOAD_IMAGE, arguments=arguments)
    start_ns = obc.now_ns
    limit_ns = start_ns + 600 * NS_PER_S
    if not obc.run_to(limit_ns, lambda: obc.packets[-1][1].name == "image_last_part"):
        raise SystemExit("the image did not come")
    taken_ns = obc.now_ns - start_ns
    parts = [packet for _, packet in obc.packets[begun:] if packet.name in PARTS]
    image_bytes = sum(len(part.fields["data"]) for part in parts)
    frames = obc.consecutive[sent:]
    best = sum(payload for payload, _ in frames) / sum(wire_ns for _, wire_ns in frames)
    rate = image_bytes / taken_ns
    others = [packet for _, packet in obc.packets[begun:] if packet.name not in PARTS]
    return {
        "bitrate": obc.bitrate,
        "image_bytes": image_bytes,
        "largest_packet_bytes": max(len(part.raw) for part in parts),
        "seconds": round(taken_ns / NS_PER_S, 3),
        "kbyte_per_s": round(rate * 1e6, 2),
        "bus_can_carry_kbyte_per_s": round(best * 1e6, 2),
        "share": round(rate / best, 4),
        "other_packets_meanwhile": len(others),
    }
