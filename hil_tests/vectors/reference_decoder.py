"""A second implementation of the wire format: `struct` only, nothing of the project.

Written from the tables of the interface document, value by value and by hand, so that a mistake in the
registry or in construct's layouts cannot be made here too. Decodes SLIP, space packets, PUS-C headers, the
packet error control and every telemetry message; makes every telecommand. Errors are ValueError. Times are
(coarse, fine).
"""

import struct

# --- line ------------------------------------------------------------------------------------------------


def slip_frame(packet):
    """RFC 1055, one byte after the other, END on both sides."""
    line = [0xC0]
    for byte in packet:
        if byte == 0xC0:
            line += [0xDB, 0xDC]
        elif byte == 0xDB:
            line += [0xDB, 0xDD]
        else:
            line.append(byte)
    return bytes([*line, 0xC0])


def slip_frames(line):
    """The good, non-empty frames of a byte string, its unfinished last one left out."""
    frames = []
    frame, escaped, good = [], False, True
    for byte in line:
        if byte == 0xC0:
            if good and not escaped and frame:
                frames.append(bytes(frame))
            frame, escaped, good = [], False, True
        elif escaped:
            escaped = False
            if byte == 0xDC:
                frame.append(0xC0)
            elif byte == 0xDD:
                frame.append(0xDB)
            else:
                good = False
        elif byte == 0xDB:
            escaped = True
        else:
            frame.append(byte)
    return frames


# --- packets ---------------------------------------------------------------------------------------------


def crc16(data):
    """ECSS-E-ST-70-41C annex B, bit by bit: x^16 + x^12 + x^5 + 1, preset to ones."""
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            feedback = (byte >> bit & 1) ^ (register >> 15)
            register = register << 1 & 0xFFFF
            if feedback:
                register ^= 0x1021
    return register


def decode_packet(raw):
    """Headers and data of a packet; its length and error control are checked."""
    if len(raw) < 8:
        raise ValueError("too short")
    word, sequence, length = struct.unpack(">HHH", raw[:6])
    if len(raw) != 6 + length + 1:
        raise ValueError("wrong length")
    if crc16(raw[:-2]) != int.from_bytes(raw[-2:], "big"):
        raise ValueError("wrong error control")
    packet = {
        "version": word >> 13,
        "packet_type": (word >> 12) & 1,
        "secondary_header": (word >> 11) & 1,
        "apid": word & 0x7FF,
        "sequence_flags": sequence >> 14,
        "sequence_count": sequence & 0x3FFF,
    }
    if packet["packet_type"] == 1:
        first, service, subservice, source_id = struct.unpack(">BBBH", raw[6:11])
        packet |= {"ack": first & 15, "source_id": source_id, "data": raw[11:-2]}
    else:
        first, service, subservice, count, destination, coarse, high, low = struct.unpack(
            ">BBBHHIBH", raw[6:20]
        )
        packet |= {
            "time_status": first & 15,
            "message_count": count,
            "destination_id": destination,
            "time": (coarse, high << 16 | low),
            "data": raw[20:-2],
        }
    packet |= {"pus_version": first >> 4, "service": service, "subservice": subservice}
    return packet


def telecommand_packet(service, subservice, data, apid, sequence_count, source_id=0, ack=9):
    """A whole telecommand packet."""
    body = bytes([0x20 | ack, service, subservice, source_id >> 8, source_id & 255]) + data
    packet = struct.pack(">HHH", 0x1800 | apid, 0xC000 | sequence_count, len(body) + 2 - 1) + body
    return packet + struct.pack(">H", crc16(packet))


# --- pieces ----------------------------------------------------------------------------------------------


class Reader:
    """Takes values off the front of bytes."""

    def __init__(self, data):
        self.data = data

    def take(self, size):
        if len(self.data) < size:
            raise ValueError("data end too early")
        part, self.data = self.data[:size], self.data[size:]
        return part

    def value(self, code):
        """One value: a struct code, or T for a time."""
        if code == "T":
            coarse, high, low = struct.unpack(">IBH", self.take(7))
            return (coarse, high << 16 | low)
        return struct.unpack(">" + code, self.take(struct.calcsize(">" + code)))[0]

    def record(self, layout):
        """A dict, from text such as 'mode:B reasons:I'."""
        return {name: self.value(code) for name, code in fields_of(layout)}

    def rest(self):
        return self.take(len(self.data))

    def end(self):
        if self.data:
            raise ValueError(f"{len(self.data)} bytes too many")


def fields_of(layout):
    """Names and codes of 'a:B b:H'."""
    return [tuple(entry.split(":")) for entry in layout.split()]


def pack(layout, values):
    """The bytes of a dict after a layout."""
    out = b""
    for name, code in fields_of(layout):
        value = values[name]
        if code == "T":
            out += struct.pack(">IBH", value[0], value[1] >> 16, value[1] & 0xFFFF)
        else:
            out += struct.pack(">" + code, value)
    return out


STRUCTURES = {
    1: "mode:B reset_cause:B boot_count:H uptime_ms:I time_status:B self_test_result:H "
    "last_frame_index:I last_reasons:I frames_processed:I frames_valid:I frames_tracking:I "
    "frames_late:I frames_dropped:I temperature_cdeg:h stored_parameters_valid:B",
    2: "tc_received:I tc_accepted:I tc_rejected:I crc_errors:H framing_errors:H length_errors:H "
    "oversized_frames:H unknown_apid:H unknown_service:H sequence_gaps:H not_allowed_in_mode:H "
    "bad_parameters:H rx_bytes:I tx_bytes:I tx_packets:I tx_queue_bytes:I",
    3: "frame_index:I cycles_total:I cycles_budget:I cycles_threshold:I cycles_clustering:I "
    "cycles_centroid:I cycles_identification:I cycles_tracking:I cycles_attitude:I "
    "cycles_telemetry:I margin_us:i worst_cycles:I clock_hz:I cycles_memory:I "
    "cache_kib:B line_fill:B",
    4: "bitrate:I bus_load:H can_state:B transmit_error_count:H receive_error_count:H tx_frames:I "
    "rx_frames:I error_frames:H bus_off_count:H arbitration_lost:I tx_refused:H cyclic_overruns:H "
    "pdus_sent:I pdus_received:I transmissions_failed:H receptions_failed:H frames_ignored:H timeouts_a:H "
    "timeouts_bs:H timeouts_cr:H wrong_sequence:H unexpected_pdus:H flow_control_errors:H too_long:H "
    "bad_length:H syncs:H syncs_ignored:H",
}

EVENTS = {  # number: (subservice of service 5, layout)
    1: (1, "boot_count:H reset_cause:B"),
    2: (1, "from_mode:B to_mode:B cause:B"),
    3: (1, "result:H"),
    4: (2, "frame_index:I cycles:I budget:I late_us:I"),
    5: (2, "frame_index:I cause:B"),
    6: (2, "frame_index:I reasons:I"),
    7: (1, "frame_index:I stars:B"),
    8: (2, "count:H length:H"),
    9: (2, "reason:B count:H length:H"),
    10: (2, "source_id:H expected:H received:H"),
    11: (3, "frame_index:I background_dn:H"),
    12: (1, "old:T new:T"),
    13: (4, "cause:B"),
    14: (3, "cause:B"),
    15: (1, "frame_index:I bytes:I"),
    16: (2, "transaction_id:H part:H"),
    17: (1, "count:H"),
    18: (1, ""),
    19: (2, "packets:H"),
    20: (2, "transmit_errors:H receive_errors:H"),
    21: (3, "duration_ms:I count:H"),
    22: (2, "reason:B count:H"),
    23: (2, "reason:B packets:H"),
}

PARAMETERS = dict(enumerate("IfBBffBffBBHBfffBBBIHBB", start=1))

FUNCTIONS = {
    4: "kind:B",
    6: "transaction_id:H first_part:H parts:H",
    11: "q_x:d q_y:d q_z:d q_w:d",
}

ATTITUDE = (
    "frame_index:I mid_exposure_time:T time_status:B mode:B valid:B reasons:I q_x:d q_y:d q_z:d q_w:d "
    "covariance_xx:f covariance_xy:f covariance_xz:f covariance_yy:f covariance_yz:f covariance_zz:f "
    "rate_valid:B rate_x:f rate_y:f rate_z:f spots_detected:H stars_identified:H windows:H "
    "window_half_width_px:H residual_rms_arcsec:f background_dn:f noise_dn:f exposure_us:I cycles:I "
    "latency_us:I late:B frames_dropped_before:H false_match_probability:f "
)
# What was added behind it later.
RATE_COVARIANCE = (
    "rate_covariance_valid:B rate_covariance_xx:f rate_covariance_xy:f rate_covariance_xz:f "
    "rate_covariance_yy:f rate_covariance_yz:f rate_covariance_zz:f"
)

IMAGE_HEADER = "frame_index:I width:H height:H bits:B reserved:B time:T exposure_us:I crc:H"


def _request_id(reader):
    word, sequence = struct.unpack(">HH", reader.take(4))
    return {
        "version": word >> 13,
        "packet_type": (word >> 12) & 1,
        "secondary_header": (word >> 11) & 1,
        "apid": word & 0x7FF,
        "sequence_flags": sequence >> 14,
        "sequence_count": sequence & 0x3FFF,
    }


def _verification(layout):
    return lambda reader: {"request_id": _request_id(reader)} | reader.record(layout)


def _housekeeping(reader):
    number = reader.value("B")
    if number not in STRUCTURES:
        raise ValueError(f"structure {number}")
    return {"structure_id": number, "values": reader.record(STRUCTURES[number])}


def _event(subservice):
    def decode(reader):
        number = reader.value("H")
        if number not in EVENTS or EVENTS[number][0] != subservice:
            raise ValueError(f"event {number}")
        return {"event_id": number, "data": reader.record(EVENTS[number][1])}

    return decode


def _memory_dump(reader):
    fields = reader.record("memory_id:B start_address:I")
    fields["data"] = reader.take(reader.value("H"))
    return fields | reader.record("checksum:H")


def _image_part(reader):
    return reader.record("transaction_id:H part_number:H") | {"data": reader.rest()}


def _parameter_values(reader):
    values = []
    for _ in range(reader.value("B")):
        number = reader.value("H")
        if number not in PARAMETERS:
            raise ValueError(f"parameter {number}")
        values.append({"parameter_id": number, "value": reader.value(PARAMETERS[number])})
    return {"values": values}


TELEMETRY = {
    (1, 1): ("acceptance_success", _verification("")),
    (1, 2): ("acceptance_failure", _verification("failure_code:H failure_data:I")),
    (1, 3): ("start_success", _verification("")),
    (1, 4): ("start_failure", _verification("failure_code:H failure_data:I")),
    (1, 5): ("progress", _verification("step:B")),
    (1, 6): ("progress_failure", _verification("step:B failure_code:H failure_data:I")),
    (1, 7): ("completion_success", _verification("")),
    (1, 8): ("completion_failure", _verification("failure_code:H failure_data:I")),
    (1, 10): ("routing_failure", _verification("failure_code:H failure_data:I")),
    (3, 25): ("hk_report", _housekeeping),
    (5, 1): ("event_info", _event(1)),
    (5, 2): ("event_low", _event(2)),
    (5, 3): ("event_medium", _event(3)),
    (5, 4): ("event_high", _event(4)),
    (5, 8): ("event_disabled_list", lambda r: {"event_ids": [r.value("H") for _ in range(r.value("B"))]}),
    (6, 6): ("memory_dump_report", _memory_dump),
    (6, 10): ("memory_check_report", lambda r: r.record("memory_id:B start_address:I length:H checksum:H")),
    (9, 2): ("time_report", lambda r: r.record("rate_exponent:B time:T time_status:B")),
    (13, 1): ("image_first_part", _image_part),
    (13, 2): ("image_part", _image_part),
    (13, 3): ("image_last_part", _image_part),
    (17, 2): ("pong", lambda r: {}),
    (20, 2): ("parameter_values", _parameter_values),
    (130, 1): ("attitude_report", lambda r: r.record(ATTITUDE + RATE_COVARIANCE)),
}


def decode_telemetry(raw):
    """A telemetry packet as a dict: the headers' values, 'name' and 'fields'."""
    packet = decode_packet(raw)
    if packet["packet_type"] != 0 or packet["pus_version"] != 2:
        raise ValueError("not PUS-C telemetry")
    name, decode = TELEMETRY[packet["service"], packet["subservice"]]
    reader = Reader(packet.pop("data"))
    fields = decode(reader)
    reader.end()
    return packet | {"name": name, "fields": fields}


def decode_image_header(data):
    """The header at the start of a downloaded image."""
    return Reader(data).record(IMAGE_HEADER)


# --- telecommands ----------------------------------------------------------------------------------------


def _list(key, code):
    return lambda fields: struct.pack(f">B{len(fields[key])}{code}", len(fields[key]), *fields[key])


def _intervals(fields):
    items = [struct.pack(">BI", item["structure_id"], item["interval_ms"]) for item in fields["intervals"]]
    return bytes([len(items)]) + b"".join(items)


def _memory_load(fields):
    head = struct.pack(">BIH", fields["memory_id"], fields["start_address"], len(fields["data"]))
    return head + fields["data"] + struct.pack(">H", fields["checksum"])


def _memory_area(fields):
    return struct.pack(">BIH", fields["memory_id"], fields["start_address"], fields["length"])


def _function(fields):
    return bytes([fields["function_id"]]) + pack(
        FUNCTIONS.get(fields["function_id"], ""), fields["arguments"]
    )


def _settings(fields):
    out = bytes([len(fields["settings"])])
    for setting in fields["settings"]:
        out += struct.pack(
            ">H" + PARAMETERS[setting["parameter_id"]], setting["parameter_id"], setting["value"]
        )
    return out


TELECOMMANDS = {
    "hk_enable": (3, 5, _list("structure_ids", "B")),
    "hk_disable": (3, 6, _list("structure_ids", "B")),
    "hk_one_shot": (3, 27, _list("structure_ids", "B")),
    "hk_set_interval": (3, 31, _intervals),
    "event_enable": (5, 5, _list("event_ids", "H")),
    "event_disable": (5, 6, _list("event_ids", "H")),
    "event_report_disabled": (5, 7, lambda fields: b""),
    "memory_load": (6, 2, _memory_load),
    "memory_dump": (6, 5, _memory_area),
    "memory_check": (6, 9, _memory_area),
    "function": (8, 1, _function),
    "time_report_rate": (9, 1, lambda fields: bytes([fields["rate_exponent"]])),
    "set_time": (9, 128, lambda fields: pack("time:T", fields)),
    "ping": (17, 1, lambda fields: b""),
    "parameter_report": (20, 1, _list("parameter_ids", "H")),
    "parameter_set": (20, 3, _settings),
}


def encode_telecommand(name, fields, apid, sequence_count, source_id=0, ack=9):
    """A whole telecommand packet by name."""
    service, subservice, data = TELECOMMANDS[name]
    return telecommand_packet(service, subservice, data(fields), apid, sequence_count, source_id, ack)
