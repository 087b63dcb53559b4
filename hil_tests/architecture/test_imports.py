"""The few places that touch a port, a clock or chance. Which room may import which: the file beside this."""

from __future__ import annotations

import ast

from hil_tests.architecture.source_tree import Source, is_in, sources, under

CAN_LINKS = {f"st_emulator/links/can/{part}.py" for part in ("bus", "records", "slcan", "socketcan")}


def offences(found: list[Source], forbidden: tuple[str, ...]) -> list[str]:
    return [
        f"{source.path} imports {name}"
        for source in found
        for name in source.imports()
        if is_in(name, *forbidden)
    ]


def test_nothing_imports_tests_or_tools():
    assert offences(under("st_emulator"), ("hil_tests", "tools")) == []
    assert offences([s for s in sources() if s.module.startswith("tools")], ("hil_tests",)) == []


def test_the_rooms_at_top_level_go_by_their_installed_name():
    assert offences(list(sources()), ("protocol", "firmware_model")) == []


def test_only_can_links_know_the_records_of_frames():
    links = [source for source in under("st_emulator.links") if source.path not in CAN_LINKS]
    assert offences(links, ("st_emulator.protocol",)) == []


def users(*packages: str) -> set[str]:
    found = under("st_emulator")
    return {source.path for source in found if any(is_in(name, *packages) for name in source.imports())}


def test_ports_are_opened_in_links_alone():
    assert users("serial") == {"st_emulator/links/serial_port.py"}
    assert users("can") == CAN_LINKS
    terminals = {"st_emulator/links/pty.py", "st_emulator/links/serial_port.py"}
    assert users("pty", "tty", "termios") == terminals
    locks = {"st_emulator/commands/running.py", "st_emulator/links/can/slcan.py"}  # a file, an adapter
    assert users("fcntl") == terminals | locks
    beside = {  # no wire: what a program that starts units asks them
        "st_emulator/drivers/supervisor_socket.py",
        "st_emulator/testing/spawned_unit.py",
        "st_emulator/testing/unit_server.py",
    }
    assert users("socket", "select") <= {
        "st_emulator/links/serial_port.py",
        "st_emulator/drivers/realtime.py",
        "st_emulator/drivers/control_server.py",  # loopback, never the unit's own wire
        "st_emulator/lockstep_client.py",
    } | {
        *CAN_LINKS,
        *beside,
        "st_emulator/links/network_interface.py",
        "st_emulator/obc/reading.py",
    }


def test_the_simulator_of_the_core_stays_in_the_tools():
    assert users("unicorn", "capstone", "elftools") == set()
    machine = [source for source in sources() if any(is_in(name, "unicorn") for name in source.imports())]
    assert machine
    assert all(source.path.startswith(("tools/arm_timing/", "hil_tests/arm/")) for source in machine)


def test_construct_stays_in_the_protocol():
    assert all(path.startswith("protocol/") for path in users("construct"))


CLOCKS = {
    "st_emulator/drivers/realtime.py": {"time.monotonic_ns"},  # the pacer
    "st_emulator/drivers/control_server.py": {"time.monotonic_ns"},  # how long a client has been silent
    "st_emulator/links/pty.py": {"time.monotonic_ns"},  # how long nobody has read
    "st_emulator/obc/reading.py": {"time.monotonic_ns", "datetime.now"},  # the OBC is a real-time program
    "st_emulator/testing/clock.py": {"time.monotonic_ns", "time.sleep"},  # waits for units in real time
    "st_emulator/commands/demo.py": {"time.monotonic", "time.sleep"},  # waits for another process
    "st_emulator/commands/running.py": {"datetime.now"},  # the date at which a live world starts
    "st_emulator/campaigns/registry.py": {"time.perf_counter"},  # how long a campaign took
    "st_emulator/campaigns/star_identification.py": {"time.perf_counter_ns"},  # and one identification
}


def clock_uses(source: Source) -> set[str]:
    """`time.x` of the module time, and `now`, `utcnow` and `today` of the module datetime's classes."""
    names = {
        alias.asname or alias.name
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Import)
        for alias in node.names
        if alias.name == "time"
    }
    uses = set()
    for node in ast.walk(source.tree):
        if isinstance(node, ast.ImportFrom) and node.module == "time" and not node.level:
            uses |= {f"time.{alias.name}" for alias in node.names}
        if not isinstance(node, ast.Attribute):
            continue
        if isinstance(node.value, ast.Name) and node.value.id in names:
            uses.add(f"time.{node.attr}")
        elif node.attr in ("now", "utcnow", "today") and ast.unparse(node.value).split(".")[-1] in (
            "datetime",
            "date",
        ):
            uses.add(f"{ast.unparse(node.value).split('.')[-1]}.{node.attr}")
    return uses


def test_the_computers_clock_is_looked_at_in_few_places():
    found = {source.path: clock_uses(source) for source in under("st_emulator")}
    assert {path: uses for path, uses in found.items() if uses} == CLOCKS


def test_clock_uses_are_found():
    text = (
        "import time\nimport time as t\nfrom time import sleep\nimport datetime\n"
        "time.time(); t.monotonic(); datetime.datetime.now(); datetime.date.today(); self.time.x; clock.now()"
    )
    source = Source("x.py", "x", ast.parse(text), 0)
    assert clock_uses(source) == {"time.time", "time.monotonic", "time.sleep", "datetime.now", "date.today"}


#: Who draws by ``random``: faults, each from a seed of its own.
CHANCE = {"st_emulator/faults/fault.py", "st_emulator/faults/chance.py"}


def test_chance_has_a_seed():
    # Of a fault's own seed, and what is given a generator that has one.
    assert users("random", "uuid") == {"st_emulator/faults/fault.py", "st_emulator/faults/chance.py"}
    assert users("secrets") == {"st_emulator/drivers/token_file.py"}  # a token is to be unknown; no result is
    for source in under("st_emulator"):
        for node in ast.walk(source.tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("default_rng"):
                assert node.args or node.keywords, f"{source.path}, line {node.lineno}: no seed"
            elif isinstance(node, ast.Attribute) and ast.unparse(node).startswith("np.random."):
                assert node.attr in ("default_rng", "Generator"), f"{source.path}, line {node.lineno}"


def test_relative_imports_are_resolved():
    package = Source(
        "a/b/__init__.py", "a.b", ast.parse("from .c import d\nfrom .. import e\nfrom . import f"), 0
    )
    assert set(package.imports()) == {"a.b.c", "a.b.c.d", "a", "a.e", "a.b", "a.b.f"}
    module = Source("a/b/g.py", "a.b.g", ast.parse("from .c import d\nfrom ..h import i\nimport x.y"), 0)
    assert set(module.imports()) == {"a.b.c", "a.b.c.d", "a.h", "a.h.i", "x.y"}
