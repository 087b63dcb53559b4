"""An ARM926EJ-S that calls functions of a compiled program and says what they cost."""

from __future__ import annotations

import ctypes
import difflib
import struct
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from capstone import CS_ARCH_ARM, CS_MODE_ARM, Cs
from unicorn import (
    UC_ARCH_ARM,
    UC_HOOK_BLOCK,
    UC_HOOK_CODE,
    UC_HOOK_INTR,
    UC_HOOK_MEM_READ,
    UC_HOOK_MEM_WRITE,
    UC_MODE_ARM,
    Uc,
    UcError,
)
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_R0,
    UC_ARM_REG_R1,
    UC_ARM_REG_SP,
    UC_CPU_ARM_926,
)
from unicorn.unicorn_const import UC_PROT_ALL
from unicorn.unicorn_py3.unicorn import uclib

from . import callbacks
from .cost import Call, Cost, Run
from .errors import ArmError
from .host_calls import HostCalls, Surroundings
from .memory import PAGE_BYTES, Memory
from .program import Program
from .state import LINE_BYTES, State

EXIT_ADDRESS = 0xF000_0000  # where a called function returns to
MOST_INSTRUCTIONS = 20_000_000_000
_STOPS = {
    callbacks.RUNAWAY: "still running after {most} instructions",
    callbacks.THUMB: "Thumb code, which has no timing here; build with -marm",
    callbacks.NO_TIMING: "{word}, an instruction that ARM926EJ-S has not, or none at all "
    "(VFP and ARMv6 have no timing here; build with -mcpu=arm926ej-s -mfloat-abi=soft)",
    callbacks.NOT_CODE: "executes what is not in the program's executable segments",
    callbacks.UNALIGNED: "an access to 0x{address:08x}, which is not aligned to its size",
}
_SUPERVISOR_CALL = 2  # EXCP_SWI of the simulator
_REGISTER_ARGUMENTS = 4  # AAPCS (IHI 0042) 6.5: r0 to r3


class ArmMachine:
    """Memory, core and caches of an ARM926EJ-S with a program in it.

    ``caches_kib`` are sizes of the instruction and of the data cache, all simulated in one run. What is
    placed from outside leaves the caches as they are; they persist over calls.
    """

    def __init__(
        self,
        elf: Path,
        *,
        memory_bytes: int = 192 << 20,
        caches_kib: Sequence[int] = (32, 16, 8, 4),
        replacement: str = "round-robin",
        max_instructions: int = MOST_INSTRUCTIONS,
    ) -> None:
        if replacement != "round-robin":
            raise ValueError(f"replacement {replacement!r}: only round-robin is modelled")
        self.program = Program.read(elf)
        self.symbols = self.program.symbols
        self.caches_kib = tuple(caches_kib)
        self.max_instructions = max_instructions
        self._memory = Memory(self.program.segments, memory_bytes)
        self.engine = Uc(UC_ARCH_ARM, UC_MODE_ARM, UC_CPU_ARM_926)
        for start, contents in self._memory.regions:
            self.engine.mem_map_ptr(start, len(contents), UC_PROT_ALL, contents.ctypes.data)
        self.engine.mem_map(EXIT_ADDRESS, PAGE_BYTES)
        self._state = State(self.program, caches_kib)
        self._add_callback(UC_HOOK_CODE, callbacks.on_instruction.address)
        self._add_callback(UC_HOOK_BLOCK, callbacks.on_block.address)
        self._add_callback(UC_HOOK_MEM_READ | UC_HOOK_MEM_WRITE, callbacks.on_access.address)
        self.engine.ctl_flush_tb()

    def _add_callback(self, kind: int, address: int) -> None:
        """As Uc.hook_add, with a compiled function instead of a Python one."""
        handle = ctypes.c_size_t()
        status = uclib.uc_hook_add(
            self.engine._uch,
            ctypes.byref(handle),
            ctypes.c_int(kind),
            ctypes.c_void_p(address),
            ctypes.c_void_p(self._state.array.ctypes.data),
            ctypes.c_uint64(1),
            ctypes.c_uint64(0),
        )
        if status:
            raise UcError(status)

    def place(self, array: npt.NDArray[Any], *, keep: bool = False) -> int:
        """Copy an array into memory, from a new line on; the address.

        It lives until `release`, or with ``keep`` for good: then the same array (its data, shape and type) is
        placed once, and must not be changed afterwards.
        """
        contiguous = np.ascontiguousarray(array)
        if keep and contiguous is not array and contiguous.nbytes:
            raise ValueError("an array to keep must be contiguous: a copy would be placed at each call")
        if keep:
            address, new = self._memory.keep(contiguous)
            if new:
                self.write(address, contiguous)
            return address
        address = self._memory.reserve(contiguous.nbytes)
        self.write(address, contiguous)
        return address

    def reserve(self, nbytes: int) -> int:
        """Address of so many zeroed bytes on a new line; they live until `release`."""
        return self._memory.reserve(nbytes)

    def read(self, address: int, dtype: npt.DTypeLike, shape: int | tuple[int, ...]) -> npt.NDArray[Any]:
        """A copy of an array in memory."""
        kind = np.dtype(dtype)
        nbytes = int(np.prod(shape)) * kind.itemsize
        return self._memory.view(address, nbytes).copy().view(kind).reshape(shape)

    def write(self, address: int, array: npt.NDArray[Any]) -> None:
        """Copy an array to an address."""
        contiguous = np.ascontiguousarray(array)
        self._memory.view(address, contiguous.nbytes)[:] = contiguous.reshape(-1).view(np.uint8)

    def dma(self, array: npt.NDArray[Any], keep_address: int | None = None) -> int:
        """As `place`, or to an address, but written by a device: its lines leave the data caches."""
        address = self.place(array) if keep_address is None else keep_address
        if keep_address is not None:
            self.write(address, array)
        self._state.invalidate(address, array.nbytes)
        return address

    def release(self) -> None:
        """Free what was placed or reserved and not kept."""
        self._memory.release()

    def flush_caches(self) -> None:
        """Empty the caches: what follows starts cold."""
        self._state.flush()

    def call(self, symbol: str, *arguments: int | float) -> Call:
        """Call a function as AAPCS says, soft float: an int is a word, a float a double.

        ArmError with pc and symbol if there is no such function, it touches memory that is not there, meets
        an instruction that ARM926EJ-S has not, or runs beyond ``max_instructions``.
        """
        start = self._address_of(symbol)
        self._set_arguments(arguments)
        cost = self._run(start)
        low, high = self.engine.reg_read(UC_ARM_REG_R0), self.engine.reg_read(UC_ARM_REG_R1)
        return Call(low, struct.unpack("<d", struct.pack("<II", low, high))[0], cost)

    def run(
        self,
        entry: str | None = None,
        *arguments: int | float,
        clock_hz: int = 400_000_000,
        cycles: Callable[[Cost], int] = lambda cost: cost.core_cycles,
        output: BinaryIO | None = None,
        errors: BinaryIO | None = None,
    ) -> Run:
        """Run a program from a symbol, or from where its file says, until it returns or ends itself.

        It may ask its host for what `HostCalls` serves; its clock shows ``cycles`` of the cost until then.
        Errors as of `call`; Linux's and semihosting's calls alone are served.
        """
        start = self.program.entry if entry is None else self._address_of(entry)
        before = self._state.snapshot()
        calls = HostCalls(
            self,
            Surroundings(
                command_line=self.program.path.name,
                heap=self._memory.free,
                stack=(self._memory.stack_top, self._memory.stack_lowest),
                clock_hz=clock_hz,
                elapsed_cycles=lambda: cycles(self._state.cost_since(before)),
                output=output or sys.stdout.buffer,
                errors=errors or sys.stderr.buffer,
            ),
        )
        self._set_arguments(arguments)
        hook = self.engine.hook_add(UC_HOOK_INTR, lambda _engine, kind, _data: self._serve(calls, kind))
        try:
            cost = self._run(start, calls)
        finally:
            self.engine.hook_del(hook)
        return Run(self.engine.reg_read(UC_ARM_REG_R0), calls.exit_code, cost)

    def _serve(self, calls: HostCalls, kind: int) -> None:
        """An exception of the processor: calls of the host are served, all else is an error."""
        word = int(self.read(int(self._state.array[callbacks.PC]), "<u4", 1)[0])
        number = word & 0xFF_FFFF
        result = None
        if kind == _SUPERVISOR_CALL:
            registers = tuple(self.engine.reg_read(UC_ARM_REG_R0 + register) for register in range(8))
            result = calls.serve(number, registers)
        if result is None:
            what = "an exception of the processor"
            if kind == _SUPERVISOR_CALL:
                what = f"SVC 0x{number:x}, which is not served"
            raise ArmError(f"at {self._place()}: {what}")
        if calls.exit_code is not None:
            self.engine.emu_stop()
        else:
            self.engine.reg_write(UC_ARM_REG_R0, result)

    def bytes_at(self, address: int, nbytes: int) -> bytes:
        """Bytes of memory."""
        return self._memory.view(address, nbytes).tobytes()

    def put_bytes(self, address: int, contents: bytes) -> None:
        """Change bytes of memory."""
        self._memory.view(address, len(contents))[:] = np.frombuffer(contents, np.uint8)

    def _address_of(self, symbol: str) -> int:
        if symbol not in self.symbols:
            near = difflib.get_close_matches(symbol, self.symbols, 3)
            hint = f"; did you mean {' or '.join(near)}?" if near else ""
            raise ArmError(f"{self.program.path}: no symbol {symbol!r}{hint}")
        return self.symbols[symbol]

    def _set_arguments(self, arguments: Sequence[int | float]) -> None:
        """Registers and stack as a function finds them."""
        registers, stacked = _arguments(arguments)
        top = self._memory.stack_top - len(stacked)
        self.put_bytes(top, stacked)
        for number in range(_REGISTER_ARGUMENTS):
            self.engine.reg_write(UC_ARM_REG_R0 + number, registers[number] if number < len(registers) else 0)
        self.engine.reg_write(UC_ARM_REG_SP, top)
        self.engine.reg_write(UC_ARM_REG_LR, EXIT_ADDRESS)

    def _run(self, start: int, calls: HostCalls | None = None) -> Cost:
        if start & 1:
            raise ArmError(
                f"{self.program.place_of(start)}: Thumb code, which has no timing here; build with -marm"
            )
        before = self._state.begin(self.max_instructions)
        try:
            self.engine.emu_start(start, EXIT_ADDRESS)
        except UcError as error:
            self._raise_if_stopped()
            raise ArmError(f"at {self._place()}: {error}") from error
        self._raise_if_stopped()
        ended = calls is not None and calls.exit_code is not None
        if not ended and self.engine.reg_read(UC_ARM_REG_PC) != EXIT_ADDRESS:
            raise ArmError(f"at {self._place()}: stopped before the function returned")
        self._state.end(EXIT_ADDRESS)
        cost = self._state.cost_since(before)
        by_blocks = self._state.instructions_by_blocks(before)
        if by_blocks != cost.instructions:
            raise ArmError(f"{cost.instructions} instructions counted one by one, {by_blocks} by blocks")
        return cost

    def _raise_if_stopped(self) -> None:
        reason = int(self._state.array[callbacks.STOPPED])
        address = int(self._state.array[callbacks.STOPPED_AT])
        if reason:
            text = _STOPS[reason].format(
                most=self.max_instructions,
                address=address,
                word=self._disassembled(address) if reason == callbacks.NO_TIMING else "",
            )
            raise ArmError(f"at {self._place()}: {text}")

    def _disassembled(self, address: int) -> str:
        contents = self.bytes_at(address, 4)
        found = next(Cs(CS_ARCH_ARM, CS_MODE_ARM).disasm(contents, address), None)
        text = f" ({found.mnemonic} {found.op_str})" if found else ""
        return f"0x{int.from_bytes(contents, 'little'):08x}{text}"

    def _place(self) -> str:
        return self.program.place_of(int(self._state.array[callbacks.PC]))


def _arguments(arguments: Sequence[int | float]) -> tuple[list[int], bytes]:
    """Registers r0 to r3 and bytes on the stack (AAPCS 6.5, stages C.3 to C.8)."""
    registers: list[int] = []
    stacked = b""
    for argument in arguments:
        if isinstance(argument, (float, np.floating)):
            words = struct.unpack("<II", struct.pack("<d", argument))
            if len(registers) % 2:
                registers.append(0)
        else:
            words = (int(argument) & 0xFFFF_FFFF,)
            if not -(1 << 31) <= int(argument) < 1 << 32:
                raise ValueError(f"{argument} is no 32-bit word")
        if len(registers) + len(words) <= _REGISTER_ARGUMENTS:
            registers += words
            continue
        registers += [0] * (_REGISTER_ARGUMENTS - len(registers))
        stacked += bytes(-len(stacked) % (4 * len(words))) + struct.pack(f"<{len(words)}I", *words)
    return registers, stacked + bytes(-len(stacked) % 8)


__all__ = ["LINE_BYTES", "ArmError", "ArmMachine", "Call", "Cost", "Run"]
