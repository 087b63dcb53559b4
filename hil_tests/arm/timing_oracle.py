"""The timing once more, slowly and by other means, to hold the compiled one against.

What was executed is written down by Python callbacks, with flags and accesses; each instruction is read from
its disassembly (capstone's text), not from its encoding; every register has a time at which each kind of
operand can have it, instead of masks that age; caches are lists of lines. The numbers are read off the
manuals again.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass, field

from capstone import CS_ARCH_ARM, CS_MODE_ARM, Cs
from unicorn import UC_HOOK_CODE, UC_HOOK_MEM_READ, UC_HOOK_MEM_WRITE
from unicorn.arm_const import UC_ARM_REG_CPSR
from unicorn.unicorn_const import UC_MEM_WRITE

from tools.arm_timing.machine import EXIT_ADDRESS, ArmMachine, Cost

NAMES = {f"r{n}": n for n in range(13)} | {
    "sb": 9,
    "sl": 10,
    "fp": 11,
    "ip": 12,
    "sp": 13,
    "lr": 14,
    "pc": 15,
}
REGISTER = re.compile(r"\b(r1[0-2]|r[0-9]|sb|sl|fp|ip|sp|lr|pc)\b")
CONDITIONS = ("eq", "ne", "hs", "lo", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt", "le")
ARITHMETIC = ("add", "sub", "rsb", "adc", "sbc")
LOGICAL = ("and", "orr", "eor", "bic", "mov", "mvn", "rsc", "lsl", "lsr", "asr", "ror", "rrx")
COMPARISONS = ("cmp", "cmn", "tst", "teq")
SHIFTS = ("lsl", "lsr", "asr", "ror", "rrx")


@dataclass
class Step:
    """One instruction as it was met."""

    pc: int
    cpsr: int
    accesses: list[tuple[bool, int, int]] = field(default_factory=list)  # (write, address, bytes)


@dataclass
class Read:
    """What its disassembly says of an instruction."""

    cycles: int
    use: tuple[int, ...] = ()  # needed when it starts to execute
    store: tuple[int, ...] = ()
    addend: tuple[int, ...] = ()
    written: tuple[int, ...] = ()
    late: dict[int, tuple[int, int, int]] = field(
        default_factory=dict
    )  # register: more cycles until each need
    jumps: bool = False


def record(machine: ArmMachine, symbol: str, *arguments: int | float) -> tuple[list[Step], Cost]:
    """Call a function; its steps, and the cost that the machine gives."""
    steps: list[Step] = []
    engine = machine.engine

    def on_code(_engine, address, _size, _data):
        steps.append(Step(address, engine.reg_read(UC_ARM_REG_CPSR)))

    def on_memory(_engine, access, address, size, _value, _data):
        steps[-1].accesses.append((access == UC_MEM_WRITE, address, size))

    hooks = [
        engine.hook_add(UC_HOOK_CODE, on_code),
        engine.hook_add(UC_HOOK_MEM_READ | UC_HOOK_MEM_WRITE, on_memory),
    ]
    engine.ctl_flush_tb()
    try:
        cost = machine.call(symbol, *arguments).cost
    finally:
        for hook in hooks:
            engine.hook_del(hook)
        engine.ctl_flush_tb()
    return steps, cost


def passes(condition: str, cpsr: int) -> bool:
    n, z, c, v = (bool(cpsr >> bit & 1) for bit in (31, 30, 29, 28))
    return {
        "": True,
        "eq": z,
        "ne": not z,
        "hs": c,
        "lo": not c,
        "mi": n,
        "pl": not n,
        "vs": v,
        "vc": not v,
        "hi": c and not z,
        "ls": not c or z,
        "ge": n == v,
        "lt": n != v,
        "gt": not z and n == v,
        "le": z or n != v,
    }[condition]


class Reader:
    """Disassembles words and reads the text."""

    def __init__(self) -> None:
        self._capstone = Cs(CS_ARCH_ARM, CS_MODE_ARM)
        self._capstone.detail = True
        self._known: dict[int, tuple[str, Read]] = {}

    def read(self, word: int) -> tuple[str, Read]:
        """(condition, reading)."""
        if word not in self._known:
            self._known[word] = self._read(word)
        return self._known[word]

    def _read(self, word: int) -> tuple[str, Read]:
        (instruction,) = self._capstone.disasm(word.to_bytes(4, "little"), 0x8000)
        name, text = instruction.insn_name(), instruction.op_str
        rest = instruction.mnemonic.removeprefix(name)
        condition = next((c for c in CONDITIONS if rest.endswith(c)), "")
        flags = rest.removesuffix(condition).startswith("s")
        return condition, self._reading(name, text, flags, word)

    def _reading(self, name: str, text: str, flags: bool, word: int) -> Read:
        registers = tuple(NAMES[found] for found in REGISTER.findall(text))
        in_list = word >> 25 & 7 == 4  # "pop {r0}" may be an LDR
        if name in COMPARISONS:
            return Read(1 + _by_register(text), registers)
        if name in ARITHMETIC + LOGICAL:
            return _processing(name, text, registers)
        if name == "clz":
            return Read(1, registers[1:], written=registers[:1])
        if (
            name in ("push", "pop", "ldm", "ldmib", "ldmda", "ldmdb", "stm", "stmib", "stmda", "stmdb")
            and in_list
        ):
            return _list(name, text)
        if name in ("push", "pop"):
            name = "ldr" if name == "pop" else "str"
            text = registers_text = f"{text.strip('{}')}, [sp], #4"
            registers = tuple(NAMES[found] for found in REGISTER.findall(registers_text))
        if name.startswith(("ldr", "str")):
            return _transfer(name, text, registers)
        return _other(name, text, registers, flags)


def _by_register(text: str) -> int:
    """One if a shift's distance is in a register."""
    return int(bool(re.search(r"\b(lsl|lsr|asr|ror) (r\d|r1[0-2]|s[bplp]|fp|ip|lr)", text)))


def _processing(name: str, text: str, registers: tuple[int, ...]) -> Read:
    if name in SHIFTS:  # MOV with a shift: "lsl r0, r1, r2"
        by_register, shifted = int(len(registers) == 3), True
    else:
        by_register, shifted = _by_register(text), any(shift in text for shift in SHIFTS)
    target, sources = registers[0], registers[1:]
    if target != 15:
        return Read(1 + by_register, sources, written=(target,))
    cycles = 4 if shifted or name not in ARITHMETIC else 3
    return Read(cycles, sources, written=(15,), jumps=True)


def _list(name: str, text: str) -> Read:
    base_text, _, list_text = ("sp!", "", text) if name in ("push", "pop") else text.partition(", ")
    base = NAMES[base_text.rstrip("!")]
    listed = sorted(NAMES[found] for found in REGISTER.findall(list_text))
    written = (base,) if base_text.endswith("!") else ()
    count = len(listed)
    if name == "push" or name.startswith("st"):
        return Read(max(2, count), (base,), tuple(listed[:1]), written=written)
    if 15 in listed:
        return Read(count + 4, (base,), written=(*written, *listed), jumps=True)
    late = {listed[-1]: (1, 1, 1)} if count > 1 else {}
    return Read(max(2, count), (base,), written=(*written, *listed), late=late)


def _transfer(name: str, text: str, registers: tuple[int, ...]) -> Read:
    double = name.endswith("d")
    data = registers[:2] if double else registers[:1]
    address = registers[len(data) :]
    scaled = int(any(f"{shift} #" in text or (shift == "rrx" and "rrx" in text) for shift in SHIFTS))
    moved = address[:1] if "!" in text or "]," in text else ()
    if name.startswith("str"):
        return Read(2 if double else 1 + scaled, address, data[:1], written=moved)
    if data == (15,):
        return Read(5 + scaled, address, written=(*moved, 15), jumps=True)
    if double:
        return Read(2, address, written=(*moved, *data), late={data[1]: (1, 1, 1)})
    narrow = name[3:4] in ("b", "h", "s")
    late = {data[0]: (2, 1, 1) if narrow else (1, 1, 1)}
    return Read(1 + scaled, address, written=(*moved, *data), late=late)


def _other(name: str, text: str, registers: tuple[int, ...], flags: bool) -> Read:
    first = registers[:1]
    if name in ("b", "bl", "bx", "blx"):
        return Read(
            3, first if name in ("bx", "blx") else (), written=(15, 14) if "l" in name else (15,), jumps=True
        )
    if name in ("mul", "mla"):
        late = {} if flags else {registers[0]: (1, 1, 0)}
        return Read(4 if flags else 2, registers[1:3], addend=registers[3:], written=first, late=late)
    if name in ("smull", "umull", "smlal", "umlal"):
        both = registers[:2]
        late = {} if flags else {register: (1, 1, 0) for register in both}
        addend = both if name.endswith("lal") else ()
        return Read(5 if flags else 3, registers[2:], addend=addend, written=both, late=late)
    if re.fullmatch(r"smlal[bt][bt]", name):
        both = registers[:2]
        return Read(
            2, registers[2:], addend=both, written=both, late={register: (1, 1, 0) for register in both}
        )
    if re.fullmatch(r"smul[btw][bt]|smla[btw][bt]", name):
        return Read(1, registers[1:3], addend=registers[3:], written=first, late={registers[0]: (1, 1, 0)})
    if name in ("qadd", "qsub", "qdadd", "qdsub"):
        return Read(1, registers[1:], written=first, late={registers[0]: (1, 0, 0)})
    if name == "mrs":
        return Read(2, written=first)
    if name == "msr":
        return Read(1 if text.startswith(("apsr_nzcvq", "cpsr_f,")) else 3, first)
    if name in ("swp", "swpb"):
        return Read(
            2, registers[2:], registers[1:2], written=first, late={first[0]: (1 + (name == "swpb"), 1, 1)}
        )
    if name == "pld":
        return Read(1, registers)
    if name == "mcr":
        return Read(1, store=first)
    if name == "mrc":
        return Read(1, written=first, late={first[0]: (1, 1, 1)})
    if name == "svc":
        return Read(3)
    raise AssertionError(f"{name} {text}")


class CacheList:
    """Four ways a set, first in first out, written back."""

    def __init__(self, kib: int) -> None:
        self._sets = [deque(maxlen=4) for _ in range(kib * 1024 // 128)]
        self.fills = self.write_backs = 0

    def access(self, address: int, *, write: bool = False) -> None:
        line = address // 32
        ways = self._sets[line % len(self._sets)]
        for way in ways:
            if way[0] == line:
                way[1] |= write
                return
        if not write:
            if len(ways) == 4:
                self.write_backs += ways[0][1]
            ways.append([line, False])
            self.fills += 1


@dataclass
class Total:
    """The figures of a machine's Cost, found again."""

    core_cycles: int
    interlock_cycles: int
    fetches: int
    data_accesses: int
    fetch_fills: dict[int, int]
    data_fills: dict[int, int]
    write_backs: dict[int, int]


def total_of(machine: ArmMachine, steps: list[Step]) -> Total:
    """The cost of recorded steps, from empty caches."""
    reader = Reader()
    time = waited = refills = accesses = 0
    ready = [[0] * 16 for _ in range(3)]  # by need: execute stage, store, addend
    fetched = {kib: CacheList(kib) for kib in machine.caches_kib}
    data = {kib: CacheList(kib) for kib in machine.caches_kib}
    for step in steps:
        word = int(machine.read(step.pc, "<u4", 1)[0])
        condition, reading = reader.read(word)
        needs = zip(ready, (reading.use, reading.store, reading.addend), strict=True)
        start = max([time, *(at[register] for at, needed in needs for register in needed)])
        waited += start - time
        executed = passes(condition, step.cpsr)
        time = start + (reading.cycles if executed else 1)
        if executed:
            refills += 2 * reading.jumps
            for register in reading.written:
                for at, more in zip(ready, reading.late.get(register, (0, 0, 0)), strict=True):
                    at[register] = time + more
        for cache in fetched.values():
            cache.access(step.pc)
        for write, address, size in step.accesses:
            accesses += -(-size // 4)
            for cache in data.values():
                cache.access(address, write=write)
    assert time < EXIT_ADDRESS
    return Total(
        time,
        waited,
        len(steps) + refills,
        accesses,
        {kib: cache.fills for kib, cache in fetched.items()},
        {kib: cache.fills for kib, cache in data.items()},
        {kib: cache.write_backs for kib, cache in data.items()},
    )
