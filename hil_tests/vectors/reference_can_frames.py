"""A second reading of the cyclic frames: whole numbers and shifts, nothing of the project.

Written by hand from the tables of the interface document: bits from the most significant on, i signed, u
unsigned, the power of two by which a number is divided behind the slash.
"""

FRAMES = {
    "heartbeat": "counter:u8 mode:u8 attitude_valid:u1 time_set:u1 can_state:u2 -:u4 boot_count:u8 "
    "uptime_s:u32",
    "attitude_1": "counter:u8 q_x:i28/27 q_y:i28/27",
    "attitude_2": "counter:u8 q_z:i28/27 q_w:i28/27",
    "rates": "counter:u8 rate_valid:u1 -:u1 rate_x:i18/19 rate_y:i18/19 rate_z:i18/19",
    "status": "counter:u8 mode:u8 valid:u1 rate_valid:u1 late:u1 time_set:u1 -:u4 reasons:u16 "
    "stars_identified:u8 spots_detected:u8 frames_dropped_before:u8",
    "mid_exposure_time": "counter:u8 seconds:u32 fraction:u24/24",
    "sync_time": "sync_counter:u8 seconds:u32 fraction:u24/24",
    "sync": "sync_counter:u8",
    "time_at_sync": "sync_counter:u8 seconds:u32 fraction:u24/24",
}

BASES = {  # of 11 bits; the node number is added but for the two that all units hear
    "heartbeat": 0x700,
    "attitude_1": 0x180,
    "attitude_2": 0x280,
    "rates": 0x380,
    "status": 0x480,
    "mid_exposure_time": 0x500,
    "sync_time": 0x400,
    "sync": 0x080,
    "time_at_sync": 0x100,
    "telecommand": 0x600,
    "telemetry": 0x580,
}


def signals(name):
    """(name, signed, bits, binary digits behind the point) of each signal, "-" for reserved bits."""
    found = []
    for entry in FRAMES[name].split():
        title, kind = entry.split(":")
        bits, _, shift = kind[1:].partition("/")
        found.append((title, kind[0] == "i", int(bits), int(shift or 0)))
    return found


def identifier(name, node):
    """The default one, 11 bits."""
    return BASES[name] + (0 if name in ("sync", "time_at_sync") else node)


def decode(name, data):
    """Values of a frame; ValueError when its length is wrong."""
    left = sum(bits for _, _, bits, _ in signals(name))
    if 8 * len(data) != left:
        raise ValueError(f"{len(data)} bytes")
    number = int.from_bytes(data, "big")
    values = {}
    for title, signed, bits, shift in signals(name):
        left -= bits
        raw = number >> left & (1 << bits) - 1
        if signed and raw >> (bits - 1):
            raw -= 1 << bits
        if title != "-":
            values[title] = raw / 2**shift if shift else raw
    return values


def encode(name, raw):
    """The bytes of a frame whose signals have the whole numbers ``raw``."""
    number = size = 0
    for title, _, bits, _ in signals(name):
        number = number << bits | raw.get(title, 0) & (1 << bits) - 1
        size += bits
    return number.to_bytes(size // 8, "big")
