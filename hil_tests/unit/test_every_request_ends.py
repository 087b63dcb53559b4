"""Whatever is commanded when: each accepted telecommand but RESET ends in exactly one report, before OFF."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from st_emulator.wire.can.wiring import CanWiring

from .conftest import make

Q = {"q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0}
COMMANDS = st.sampled_from(
    [
        ("function", {"function_id": 1, "arguments": {}}),
        ("function", {"function_id": 2, "arguments": {}}),
        ("function", {"function_id": 3, "arguments": {}}),
        ("function", {"function_id": 4, "arguments": {"kind": 0}}),
        ("function", {"function_id": 5, "arguments": {}}),
        ("function", {"function_id": 6, "arguments": {"transaction_id": 1, "first_part": 0, "parts": 0}}),
        ("function", {"function_id": 7, "arguments": {}}),
        ("function", {"function_id": 11, "arguments": Q}),
        ("set_time", {"time": (2_000_000_000, 0)}),
        ("ping", {}),
    ]
)


WIRES: dict[str, dict[str, Any]] = {
    "serial line": {"wire": {"baud": 1_000_000}},
    "CAN": {"can": CanWiring()},
    "CAN FD in blocks": {"can": CanWiring(fd=True), "can_section": {"block_size": 2}},
}


@pytest.mark.parametrize("kind", WIRES)
@settings(max_examples=25, deadline=None)
@given(commands=st.lists(st.tuples(COMMANDS, st.sampled_from([0, 1, 40, 130, 400, 900])), max_size=10))
def test_every_request_ends(kind: str, commands: list) -> None:
    bench = make(**WIRES[kind]).boot()
    resets, counts = [], []
    for (name, fields), pause_ms in commands:
        count = bench.send(name, fields)
        counts.append(count)
        if fields.get("function_id") == 4:
            resets.append(count)
        bench.run(pause_ms)
    if kind == "CAN":
        # A telecommand that came in a boot is given up after N_Bs; those behind it, resets among them, wait.
        bench.run_until(lambda: not bench.peer.sending, limit_ms=30_000)
    bench.run(1000)  # past a boot, so that the shutdown is heard
    counts.append(bench.function("SHUTDOWN"))
    bench.run(1000)
    for count in counts:
        stages = bench.stages(count)
        ends = [stage for stage in stages if stage.startswith("completion")]
        if not stages or stages == ["acceptance_failure"]:
            continue  # lost in BOOT, or refused
        assert stages[0] == "acceptance_success"
        assert len(ends) == (0 if count in resets else 1), stages
        assert not ends or stages[-1] == ends[0]
    assert bench.stages(counts[-1])[-1] == "completion_success"
