"""Instruction timings of ARM9EJ-S, the core of ARM926EJ-S, when every memory access hits its cache.

Sources, cited row by row:

- A: ARM9EJ-S Technical Reference Manual, ARM DDI 0222B, table 8.2 (cycle counts and bus activity).
- B: ARM9E-S Technical Reference Manual, ARM DDI 0165B, page 8-22 (interlocks of loads; the C read port).
- C: ARM7EJ-S Technical Reference Manual, ARM DDI 0214B, 9.9.1 and 9.10.1 (interlocks of the multiplier and of
  saturating additions; the same generation's core, whose cycle counts of these instructions are the same).
- U: unverified here: from summaries of the manuals, or a reading that their text leaves open.
"""

from __future__ import annotations

from dataclasses import dataclass

CONDITION_FAILED_CYCLES = 1  # U
REFILL_FETCHES = 2  # A: a change of pc reads 2S + 1N on the instruction bus, one word of which is its own
LEAST_MULTIPLE_CYCLES = 2  # A: LDM of one register; U for STM


@dataclass(frozen=True)
class Row:
    """Cycles of an instruction, and by how many more the next one waits that uses its result.

    ``use``: at an operand of the execute stage (an address, the ALU, a multiplier); ``store``: as data to
    store (the C read port); ``accumulate``: as the addend of a multiply-accumulate. ``per_register`` is added
    for each register of a list; ``least`` bounds the sum. An LDM's or LDRD's last register alone has to be
    waited for.
    """

    name: str
    cycles: int
    source: str
    use: int = 0
    store: int = 0
    accumulate: int = 0
    per_register: int = 0
    least: int = 0

    def total(self, registers: int = 0) -> int:
        """Cycles with a list of so many registers."""
        return max(self.cycles + self.per_register * registers, self.least)


ROWS = (
    Row("alu", 1, "A"),
    Row("alu_register_shift", 2, "A"),
    Row("alu_to_pc_arithmetic", 3, "A: ADD, SUB, RSB, ADC, SBC"),
    Row("alu_to_pc_logical", 4, "A: others; RSC too"),
    Row("alu_to_pc_shifted", 4, "A: with operand shift; U: taken to be of any kind but LSL #0"),
    Row("clz", 1, "A"),
    Row("load_word", 1, "A; C port: B", use=1, store=1, accumulate=1),
    Row("load_word_scaled", 2, "A; C port: B", use=1, store=1, accumulate=1),
    Row("load_narrow", 1, "A; C port: B, U for bytes", use=2, store=1, accumulate=1),
    Row("load_narrow_scaled", 2, "A; C port: B, U for bytes", use=2, store=1, accumulate=1),
    Row("load_pc", 5, "A"),
    Row("load_pc_scaled", 6, "A"),
    Row("load_double", 2, "A", use=1, store=1, accumulate=1),
    Row("store", 1, "A"),
    Row("store_scaled", 2, "A"),
    Row("store_double", 2, "A"),
    # A list of one register takes two cycles and leaves nothing to wait for: its second cycle is the wait
    # (U).
    Row("load_multiple", 0, "A", use=1, store=1, accumulate=1, per_register=1, least=LEAST_MULTIPLE_CYCLES),
    Row("load_multiple_pc", 4, "U: n + 4", per_register=1),
    Row("store_multiple", 0, "U: n, at least 2", per_register=1, least=LEAST_MULTIPLE_CYCLES),
    Row("multiply", 2, "C", use=1, store=1),
    Row("multiply_flags", 4, "C: no interlock after it"),
    Row("multiply_long", 3, "C; U: both halves are waited for", use=1, store=1),
    Row("multiply_long_flags", 5, "C: no interlock after it"),
    Row("multiply_halfword", 1, "U: SMULxy, SMLAxy, SMULWy, SMLAWy; interlock: C", use=1, store=1),
    Row("multiply_halfword_long", 2, "U: SMLALxy; interlock: C", use=1, store=1),
    Row("saturating", 1, "C: QADD, QSUB, QDADD, QDSUB", use=1),
    Row("branch", 3, "U: B, BL, BX, BLX when taken"),
    Row("mrs", 2, "U"),
    Row("msr_flags", 1, "U"),
    Row("msr_control", 3, "U: another field than the flags"),
    Row("swap_word", 2, "U", use=1, store=1, accumulate=1),
    Row("swap_byte", 2, "U", use=2, store=1, accumulate=1),
    Row("preload", 1, "U: PLD; it fills no line here"),
    Row("coprocessor_write", 1, "U: MCR without busy-waiting"),
    Row("coprocessor_read", 1, "U: MRC without busy-waiting", use=1, store=1, accumulate=1),
    Row("software_interrupt", 3, "U"),
)
ROW_NUMBERS = {row.name: number for number, row in enumerate(ROWS)}
