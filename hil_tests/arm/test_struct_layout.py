"""Layouts of C structs from debug information: against layouts computed by hand, and all that is used."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from hil_tests.arm.conftest import require_compiler
from tools.arm_timing.machine import ArmMachine
from tools.calibration.compiler import KERNELS, Build, build
from tools.calibration.struct_layout import (
    LayoutError,
    StructLayouts,
    layout_of,
    place_struct,
    read_struct,
    read_structs,
)

BINDINGS = Path(__file__).parents[2] / "tools" / "calibration" / "steps"
# AAPCS (IHI 0042), 5: doubles and 64-bit words on multiples of 8, words and pointers on multiples of 4.
SMALL = """
#include <stdint.h>
typedef struct { uint16_t low; uint8_t high; } st_inner;                       /* 4 bytes */
typedef enum { ST_A, ST_B } st_kind;
typedef struct st_small {
    int8_t sign;            /* 0 */
    double value;           /* 8 */
    const st_inner *inners; /* 16 */
    const void *room;       /* 20 */
    struct st_small *next;  /* 24 */
    float single;           /* 28 */
    st_inner inner;         /* 32 */
    st_inner pair[2];       /* 36 */
    uint8_t table[2][3];    /* 44 */
    volatile int64_t wide;  /* 56 */
    st_kind kind;           /* 64, enumerations are words */
} st_small;                 /* 72 */
typedef struct { unsigned flag : 1; } st_bits;
typedef struct { union { int i; float f; } either; } st_union;
int st_small_sign(const st_small *small) { return small->sign + small->kind + small->pair[1].high; }
int st_of_bits(st_bits *bits) { return bits->flag; }
int st_of_union(st_union *it) { return it->either.i; }
"""
OFFSETS = {
    "sign": 0,
    "value": 8,
    "inners": 16,
    "room": 20,
    "next": 24,
    "single": 28,
    "inner": 32,
    "pair": 36,
    "table": 44,
    "wide": 56,
    "kind": 64,
}
VALUES = {
    "sign": -3,
    "value": 2.5,
    "inners": 0x1000,
    "room": 0x2000,
    "next": 0xFFFF_FFFF,
    "single": 0.5,
    "inner": {"low": 1, "high": 2},
    "pair": np.zeros(2, np.dtype({"names": ["low", "high"], "formats": ["<u2", "u1"], "itemsize": 4})),
    "table": [[1, 2, 3], [4, 5, 6]],
    "wide": -(1 << 40),
    "kind": 1,
}


@pytest.fixture(scope="module")
def small_elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_compiler()
    sources = tmp_path_factory.mktemp("small") / "sources"
    shutil.copytree(KERNELS / "runtime", sources / "runtime")
    (sources / "small.c").write_text(SMALL, encoding="utf-8")
    return build(sources.parent / "out", sources=sources).elf


@pytest.fixture(scope="module")
def small(small_elf: Path) -> StructLayouts:
    return StructLayouts(small_elf)


def test_members_lie_where_aapcs_puts_them(small: StructLayouts) -> None:
    layout = small["st_small"]
    assert {name: layout.offset(name) for name in layout.members} == OFFSETS
    assert layout.nbytes == 72
    assert layout.dtype["table"].shape == (2, 3)
    assert layout.item_bytes == {"inners": 4, "room": 0, "next": 72}
    assert layout.items_bytes("inners", 5) == 20


def test_what_is_packed_is_what_a_hand_written_format_packs(small: StructLayouts) -> None:
    form = "<b7xd3IfHBxHBxHBx6B6xqI4x"
    expected = struct.pack(
        form, -3, 2.5, 0x1000, 0x2000, 0xFFFF_FFFF, 0.5, 1, 2, 0, 0, 0, 0, *range(1, 7), -(1 << 40), 1
    )
    assert small["st_small"].pack(**VALUES).tobytes() == expected
    found = np.frombuffer(expected, small["st_small"].dtype)[0]
    assert (found["sign"], found["value"], found["wide"], found["kind"]) == (-3, 2.5, -(1 << 40), 1)
    assert found["table"].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert (found["inner"]["low"], found["inner"]["high"]) == (1, 2)


def test_the_compiled_code_reads_what_was_packed(small_elf: Path) -> None:
    machine = ArmMachine(small_elf)
    pair = layout_of(machine, "st_inner").pack_array(2, low=[7, 8], high=[9, 40])
    address = place_struct(machine, "st_small", **VALUES | {"pair": pair})
    assert machine.call("st_small_sign", address).result == -3 + 1 + 40
    assert read_struct(machine, "st_small", address)["pair"]["low"].tolist() == [7, 8]
    assert read_structs(machine, "st_small", address, 1)["single"].tolist() == [0.5]
    with pytest.raises((KeyError, ValueError), match="flux"):
        read_struct(machine, "st_small", address)["flux"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"walue": 1.0}, r"st_small has no member walue; it has sign, value"),
        ({"inner": {"low": 1, "hi": 2}}, r"st_small\.inner has no member hi; it has low, high"),
        ({"inner": {"low": 1}}, r"st_small\.inner: no value is given for high"),
        ({"sign": 128}, r"st_small\.sign is int8, which does not hold 128"),
        ({"sign": 1.0}, r"st_small\.sign is int8, which does not hold 1\.0"),
        ({"inners": -1}, r"st_small\.inners is uint32, which does not hold -1"),
        ({"table": [1, 2, 3]}, r"st_small\.table has the shape \(2, 3\), not \(3,\)"),
        ({"value": "2.5"}, r"st_small\.value is float64"),
        ({"pair": np.zeros(2, "<u4")}, r"st_small\.pair is"),
    ],
)
def test_what_a_struct_has_not_or_cannot_hold_is_refused(
    small: StructLayouts, changes: dict[str, object], says: str
) -> None:
    with pytest.raises(LayoutError, match=says):
        small["st_small"].pack(**VALUES | changes)


def test_a_member_left_out_is_refused(small: StructLayouts) -> None:
    for name in VALUES:
        with pytest.raises(LayoutError, match=f"st_small: no value is given for {name}"):
            small["st_small"].pack(**{other: value for other, value in VALUES.items() if other != name})


def test_names_that_are_not_there_are_refused(small: StructLayouts) -> None:
    with pytest.raises(LayoutError, match="no struct 'st_large'"):
        small["st_large"]
    with pytest.raises(LayoutError, match="no member 'walue'"):
        small["st_small"].offset("walue")
    with pytest.raises(LayoutError, match=r"st_small\.room is no pointer to anything of a size"):
        small["st_small"].items_bytes("room", 1)
    with pytest.raises(LayoutError, match=r"st_small\.value is no pointer"):
        small["st_small"].items_bytes("value", 1)


@pytest.mark.parametrize("name", ["st_bits", "st_union"])
def test_what_has_no_layout_is_refused(small: StructLayouts, name: str) -> None:
    with pytest.raises(LayoutError, match=r"a bit field|DW_TAG_union_type"):
        small[name]


def test_a_member_moved_in_c_is_followed_and_one_added_is_an_error(tmp_path: Path) -> None:
    require_compiler()
    sources = tmp_path / "sources"
    shutil.copytree(KERNELS / "runtime", sources / "runtime")
    layouts = []
    for number, members in enumerate(("int a; double b;", "double b; int a;", "int a; int c; double b;")):
        code = f"typedef struct {{ {members} }} st_it; double st_f(st_it *it) {{ return it->b; }}\n"
        (sources / "it.c").write_text(code, encoding="utf-8")
        layouts.append(StructLayouts(build(tmp_path / str(number), sources=sources).elf)["st_it"])
    assert layouts[0].pack(a=3, b=1.0).tobytes() == struct.pack("<i4xd", 3, 1.0)
    assert layouts[1].pack(a=3, b=1.0).tobytes() == struct.pack("<di4x", 1.0, 3)
    with pytest.raises(LayoutError, match="no value is given for c"):
        layouts[2].pack(a=3, b=1.0)


def test_two_structs_of_one_name_are_refused(tmp_path: Path) -> None:
    require_compiler()
    sources = tmp_path / "sources"
    shutil.copytree(KERNELS / "runtime", sources / "runtime")
    for name, kind in (("one", "int"), ("other", "double")):
        code = f"typedef struct {{ {kind} a; }} st_it; int st_{name}(st_it *it) {{ return it->a != 0; }}\n"
        (sources / f"{name}.c").write_text(code, encoding="utf-8")
    layouts = StructLayouts(build(tmp_path / "out", sources=sources).elf)
    with pytest.raises(LayoutError, match="several structs 'st_it' that differ"):
        layouts["st_it"]


def test_a_program_without_debug_information_is_refused(small_elf: Path, tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match="no debug information"):
        StructLayouts(small_elf.parent / "hashed" / small_elf.name)
    (tmp_path / "no.elf").write_bytes(b"no")
    with pytest.raises(LayoutError, match="not an ELF file"):
        StructLayouts(tmp_path / "no.elf")


def test_every_struct_that_a_binding_or_a_test_names_is_in_the_program(arm_build: Build) -> None:
    layouts = StructLayouts(arm_build.elf)
    call = re.compile(r"\b(?:layout_of|place_struct|reserve_structs|read_structs?|_place_room)\(")
    name = re.compile(r"[^()]*?\"(st_\w+)\"")
    used = set()
    for path in [*BINDINGS.glob("*.py"), *Path(__file__).parent.glob("test_*_kernel*.py")]:
        text = path.read_text(encoding="utf-8")
        for match in call.finditer(text):
            named = name.match(text, match.end())
            if named is not None:
                used.add(named[1])
    assert len(used) > 25
    assert used <= layouts.names
    for struct_name in used:
        assert layouts[struct_name].members


def test_every_struct_of_a_header_has_a_layout(arm_build: Build) -> None:
    """So that a binding can be written for any of them."""
    layouts = StructLayouts(arm_build.elf)
    declared = {
        name for path in KERNELS.rglob("*.h") for name in re.findall(r"^\} (st_\w+);", path.read_text(), re.M)
    }
    assert len(declared) > 30
    for name in declared:
        assert layouts[name].nbytes % 4 == 0


def test_no_binding_types_a_layout() -> None:
    """A format string of ``struct``, or a NumPy type of members, would be a second place that says it."""
    typed = re.compile(r"struct\.(?:Struct|pack|unpack)\w*\(|np\.dtype\(\s*[\[{]")
    found = {
        f"{path.name}: {match[0]}"
        for path in [*BINDINGS.glob("*.py"), *Path(__file__).parent.glob("test_*_kernel*.py")]
        for match in typed.finditer(path.read_text(encoding="utf-8"))
    }
    # A date as two words; and what is on the line, which is big-endian and no struct of C.
    assert found <= {
        "attitude.py: struct.pack(",
        "attitude.py: struct.unpack(",
        "test_telemetry_kernels.py: struct.pack(",
        "test_telemetry_kernels.py: struct.unpack(",
    }


def test_debug_information_changes_nothing_of_the_program(
    arm_build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A build without -g: the program is what ours is without its debug information, byte by byte."""
    monkeypatch.setattr("tools.calibration.compiler.DEBUG_FLAGS", ())
    plain = build(tmp_path / "plain")
    with pytest.raises(LayoutError, match="no debug information"):
        StructLayouts(plain.elf)
    assert plain.elf.read_bytes() == (arm_build.elf.parent / "hashed" / "kernels.elf").read_bytes()
    assert plain.sha256 == arm_build.sha256
    sizes = [
        subprocess.run(["readelf", "-lW", elf], capture_output=True, text=True, check=True).stdout
        for elf in (plain.elf, arm_build.elf)
    ]
    loaded = [re.findall(r"^ +LOAD .*", text, re.M) for text in sizes]
    assert loaded[0] == loaded[1] != []
