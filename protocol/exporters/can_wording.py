"""The prose of the interface document's chapter on the CAN bus: what no table says."""

from __future__ import annotations

BUS = (
    "A unit on a CAN bus (ISO 11898-1, bit rate in the unit's file) says and does what it does on the",
    "serial line: the packets are the same, byte by byte, and what follows from them. The frames in this",
    "chapter are additional. Numbers are big-endian; bit 0 is the most significant of its byte, as in the",
    "whole document (a DBC counts otherwise). `st-emulator export dbc` writes all frames of given units",
    "for CAN tools.",
    "",
    "Applicable in addition: ISO 11898-1:2015 (CAN and CAN FD), ISO 15765-2:2016 (transport, ISO-TP);",
    "ECSS-E-ST-50-15C (1 May 2015) for the idea of the time distribution, known here second-hand.",
    "",
)

CYCLIC = (
    "Any CAN tool reads these without a transport. They are classic frames (at most 8 bytes) on CAN FD",
    "buses too. u4 is an unsigned, i28 a signed number of so many bits (two's complement); a signal's value",
    "is its number times the scale. What is out of a signal's range is sent as the nearest end of the range;",
    "there is no NaN.",
    "",
    "- **heartbeat**: each `heartbeat_ms` (0: never), from the end of the boot on, in every mode but BOOT",
    "  and OFF.",
    "- **attitude_1, attitude_2, rates, status, mid_exposure_time**: with the attitude report TM[130,1]",
    "  of the frame, also while parameter attitude_report is 0; `attitude_frames`, `rates_frames`,",
    "  `status_frames` and `time_frames` say of how many frames it is one (the frame index is a multiple",
    "  of the figure; 0: never). All of one image carry the same `counter`, the low byte of its frame",
    "  index: halves of a quaternion whose counters differ do not belong together.",
    "- An attitude that is not valid (`status`, `valid` 0) repeats the last valid one. The rate has a flag",
    "  of its own and may be valid then. For its covariance there is no room: the attitude report has it.",
    "- A cyclic frame that still waits for the bus when the next of its kind comes is replaced by it,",
    "  which housekeeping counts as `cyclic_overruns`.",
    "- **sync_time** answers each SYNC, see [time distribution](#time-distribution).",
    "",
    "A frame of the OBC on the identifiers of `sync` and `time_at_sync` whose length is not the one below",
    "is ignored and counted (`syncs_ignored`); an empty SYNC is allowed.",
    "",
)

TRANSPORT = (
    "Each packet is one transfer by ISO-TP (ISO 15765-2): a single frame when it fits, else a first",
    "frame, flow control of the receiver and consecutive frames. The SLIP framing of the line is not",
    "used. Telecommands and the flow control of telemetry travel on identifier `telecommand`, telemetry",
    "and the flow control of telecommands on `telemetry`; both directions may be under way at once. A",
    "unit on CAN FD also takes classic frames.",
    "",
)

FAILURES = (
    "Whatever stands on the unit's identifiers is no reason to stop: it is a packet, or it is counted in",
    "housekeeping structure CAN under one of the reasons of [TransferFailure](#transferfailure), and the",
    "next good transfer is taken. A reception that fails and a frame that is ignored are told by event",
    "CAN_TRANSFER_FAILED, at once and then at most once a second with the number since the last one. A",
    "single or first frame ends the reception that is under way (UNEXPECTED_PDU). A transfer that arrives",
    "whole is handled as a frame of the line (*Reception of telecommands*, reasons 1 to 15).",
    "",
    "Error frames, error passive and bus-off change nothing in the queues: frames are sent again until",
    "they leave or N_As is over. Events CAN_ERROR_PASSIVE_ENTERED and CAN_BUS_OFF_RECOVERED tell the",
    "controller's states. From bus-off it recovers by itself: `bus_off_restart_ms` and 128 times 11",
    "recessive bits.",
    "",
)

NO_RECEIVER = (
    "When no flow control comes within N_Bs, or nothing but WAIT, or the controller cannot get a frame out",
    "within N_As because nobody acknowledges it, there is no receiver. The packet under way is lost then,",
    "and with it all packets that have waited for longer than that timeout, so that an OBC that comes back",
    "does not read old telemetry first. The sequence counts of lost packets are used up: the gap shows.",
    "Then the unit tries the next packet, so that it asks for flow control about once in N_Bs while nobody",
    "listens. When packets are taken again, what has grown older than the timeout behind the first one is",
    "lost as well, and event CAN_PACKETS_LOST tells how many were lost and why the first one was; a report",
    "that gets lost itself is made up for by the next. Any other failure of a transmission (overflow,",
    "invalid flow status) loses the packet under way only; it is told in the same way.",
    "",
    "With CAN FD short packets are single frames, which no flow control answers: they count as taken as",
    "soon as any node acknowledges them. They show that the OBC is back only if a telecommand has come",
    "meanwhile.",
    "",
    "Cyclic frames need no receiver; without an acknowledgement they wait, the newest of each kind.",
    "",
)

TIME = (
    "After ECSS-E-ST-50-15C (second-hand: SYNC marks the instant, a message with the time in CUC with 4 +",
    "3 bytes, there SCET, follows it; here both are frames of this interface and the time is TAI since",
    "1958-01-01):",
    "",
    "1. The OBC sends `sync` with a counter of its choice. Each unit latches its on-board time at the",
    "   instant at which the last bit of that frame is in, whatever the load of the bus, and sends it as",
    "   `sync_time`: the OBC can compare clocks without setting them.",
    "2. The OBC sends `time_at_sync` with the same counter and the time at which that SYNC ended, within",
    "   1 s. The unit carries it on to the next frame start and takes it over there, exactly as with",
    "   telecommand `set_time`; event TIME_SET tells it. A telecommand set_time that still waits then is",
    "   superseded.",
    "3. A `time_at_sync` without its SYNC, later than 1 s after it, or in a mode in which set_time is not",
    "   allowed, is ignored and counted (`syncs_ignored`).",
    "",
)

BUS_MODEL = (
    "**Modelled.** Each frame occupies the bus for its bits, the stuff bits of its very contents and 3",
    "bits of intermission included, at the bit rate (CAN FD: data phase at `data_bitrate`); one frame at",
    "a time. Of the frames that wait when the bus becomes idle the lowest identifier wins, of the unit or",
    "of others; the loser waits and is counted. `bus_load` is the share of the last whole second in which",
    "the bus was busy. Errors destroy an attempt, cost their error frame and the error counters of ISO",
    "11898-1 (active, passive, bus-off), and the frame is sent again. A link that takes no frame (its",
    "transmit queue is full) is asked again each millisecond. On a link to a controller in hardware the",
    "bus itself does all this; states and counters then come from its driver's error messages.",
    "",
    "**Not modelled.** Sampling, propagation delay and bit timing; the transceiver; two frames of the",
    "same identifier from two nodes (they go one after the other); overload frames; the bits of error",
    "frames of other nodes beyond the longest superposition of flags. Nodes on a virtual bus see a frame",
    "when the emulated bus has carried it; with several units, each emulator models the bus by itself",
    "from what it sees, so that the order of frames that wait in two emulators at once is that of their",
    "arrival.",
    "",
)
