"""The build of the flight kernels: every file, every function, always the same bytes."""

from __future__ import annotations

import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from elftools.elf.elffile import ELFFile

from hil_tests.arm.conftest import require_compiler
from tools.calibration import compiler, packages
from tools.calibration.compiler import (
    KERNELS,
    PINNED_COMPILER,
    Build,
    BuildError,
    CompilerMissingError,
    build,
    shared_build,
)

MOST_LINES = 500
# Members of the C library that a program without an operating system may be given.
OF_THE_C_LIBRARY = {"memcpy.o", "memset.o", "memmove.o", "errno.o", "s_ldexp.o", "s_scalbn.o", "s_frexp.o"}


@pytest.fixture
def small_sources(tmp_path: Path) -> Path:
    """The runtime and one kernel."""
    require_compiler()
    folder = tmp_path / "sources"
    shutil.copytree(KERNELS / "runtime", folder / "runtime")
    (folder / "twice.h").write_text("int st_twice(int);\n")
    (folder / "twice.c").write_text('#include "twice.h"\nint st_twice(int x) { return 2 * x; }\n')
    return folder


def symbols(elf: Path) -> set[str]:
    with elf.open("rb") as file:
        return {symbol.name for symbol in ELFFile(file).get_section_by_name(".symtab").iter_symbols()}


def test_every_function_of_every_header_is_in_the_program(arm_build: Build) -> None:
    declared = set()
    for header in KERNELS.rglob("*.h"):
        text = re.sub(r"/\*.*?\*/", "", header.read_text(), flags=re.DOTALL)
        declared |= set(re.findall(r"\b(st_\w+)\s*\([^;{}]*\)\s*;", text))
    assert len(declared) > 20
    assert declared <= symbols(arm_build.elf)


def test_every_file_has_its_hash(arm_build: Build) -> None:
    objects = {path.relative_to(KERNELS).with_suffix(".o").as_posix() for path in KERNELS.rglob("*.c")}
    assert objects | {"kernels.elf", "libm.a", "libc.a", "libgcc.a"} == set(arm_build.sha256)
    assert all(re.fullmatch("[0-9a-f]{64}", value) for value in arm_build.sha256.values())
    assert arm_build.compiler.startswith("gcc ")
    assert "-O2" in arm_build.flags


def test_the_same_bytes_in_any_folder(arm_build: Build, tmp_path: Path) -> None:
    copy = tmp_path / "elsewhere" / "kernels"
    shutil.copytree(KERNELS, copy)
    again = build(tmp_path / "a folder with another name", sources=copy)
    assert again.sha256 == arm_build.sha256
    assert again.elf.read_bytes() == arm_build.elf.read_bytes()
    assert str(tmp_path).encode() not in again.elf.read_bytes()


def test_the_program_is_for_an_arm926ej_s(arm_build: Build) -> None:
    with arm_build.elf.open("rb") as file:
        elf = ELFFile(file)
        assert elf.header["e_machine"] == "EM_ARM"
        assert elf.header["e_type"] == "ET_EXEC"
        attributes = {
            attribute.tag: attribute.value
            for attribute in next(
                next(elf.get_section_by_name(".ARM.attributes").iter_subsections()).iter_subsubsections()
            ).iter_attributes()
        }
        assert attributes["TAG_CPU_ARCH"] == 5  # v5TEJ
        assert "TAG_FP_ARCH" not in attributes  # no floating point unit
        assert "TAG_ABI_VFP_ARGS" not in attributes  # doubles in core registers
        assert not any(segment["p_type"] in ("PT_INTERP", "PT_DYNAMIC") for segment in elf.iter_segments())


def test_of_the_c_library_hardly_anything_is_linked(arm_build: Build) -> None:
    linked = set(re.findall(r"libc\.a\((\S+)\)", (arm_build.elf.parent / "kernels.map").read_text()))
    assert linked <= OF_THE_C_LIBRARY
    assert "memcpy.o" in linked


def test_no_kernel_has_a_warning(arm_build: Build) -> None:
    found = compiler.find_compiler()
    assert found is not None
    line = [found.path, *compiler.COMPILE_FLAGS, "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I."]
    sources = sorted(path.relative_to(KERNELS).as_posix() for path in KERNELS.rglob("*.c"))
    done = subprocess.run([*line, *sources], cwd=KERNELS, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_no_file_is_too_long_to_be_read_at_a_sitting() -> None:
    long = {path.name for path in KERNELS.rglob("*.[ch]") if path.read_text().count("\n") > MOST_LINES}
    assert long == set()


def test_a_file_that_does_not_compile_is_named(small_sources: Path, tmp_path: Path) -> None:
    (small_sources / "odd.c").write_text("int st_odd(void) { return missing; }\n")
    with pytest.raises(BuildError, match=r"odd\.c does not compile.*(.|\n)*missing"):
        build(tmp_path / "out", sources=small_sources)


def test_a_function_that_is_nowhere_is_named(small_sources: Path, tmp_path: Path) -> None:
    (small_sources / "odd.c").write_text("int st_no(void); int st_odd(void) { return st_no(); }\n")
    with pytest.raises(BuildError, match=r"does not link(.|\n)*st_no"):
        build(tmp_path / "out", sources=small_sources)


def test_a_folder_without_sources_is_no_program(tmp_path: Path) -> None:
    require_compiler()
    with pytest.raises(BuildError, match="no C file"):
        build(tmp_path / "out", sources=tmp_path)


def test_processes_share_one_build(
    small_sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []

    def counted(folder: Path, *, sources: Path = KERNELS) -> Build:
        built.append(folder)
        return build(folder, sources=sources)

    monkeypatch.setattr(compiler, "build", counted)
    cache = tmp_path / "cache"
    with ThreadPoolExecutor(8) as pool:
        builds = list(pool.map(lambda _: shared_build(sources=small_sources, cache=cache), range(8)))
    assert len(built) == 1
    assert all(one == builds[0] for one in builds)
    assert builds[0].sha256 == build(tmp_path / "out", sources=small_sources).sha256
    assert "st_twice" in symbols(builds[0].elf)

    before = builds[0].elf.read_bytes()
    (small_sources / "twice.h").write_text("int st_twice(int); int st_more(void);\n")
    (small_sources / "more.c").write_text('#include "twice.h"\nint st_more(void) { return st_twice(2); }\n')
    after = shared_build(sources=small_sources, cache=cache)
    assert len(built) == 2
    assert "st_more" in symbols(after.elf)
    assert builds[0].elf.read_bytes() == before  # a run that uses it keeps it


def test_a_build_that_failed_is_not_kept(small_sources: Path, tmp_path: Path) -> None:
    good = (small_sources / "twice.c").read_text()
    (small_sources / "twice.c").write_text("int st_twice(int x) { return 2 * x }\n")
    for _ in range(2):
        with pytest.raises(BuildError, match=r"twice\.c"):
            shared_build(sources=small_sources, cache=tmp_path / "cache")
    (small_sources / "twice.c").write_text(good)
    assert shared_build(sources=small_sources, cache=tmp_path / "cache").elf.is_file()


@pytest.mark.parametrize(
    ("line", "version"),
    [
        ("arm-linux-gnueabi-gcc (Debian 12.2.0-14) 12.2.0", PINNED_COMPILER),
        ("arm-linux-gnueabi-gcc (Ubuntu 13.3.0-6ubuntu2) 13.3.0", "gcc 13.3.0 (Ubuntu 13.3.0-6ubuntu2)"),
    ],
)
def test_which_compiler_it_is(line: str, version: str, tmp_path: Path) -> None:
    program = tmp_path / "arm-linux-gnueabi-gcc"
    library = tmp_path / "libx.a"
    library.write_bytes(b"x")
    program.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo "{line}" || echo {library}\n')
    program.chmod(0o755)
    found = compiler._inspect(str(program))
    assert found is not None
    assert found.version == version
    assert found.pinned == (version == PINNED_COMPILER)
    assert set(found.libraries) == {"libx.a"}


def test_a_compiler_without_its_c_library_is_none(tmp_path: Path) -> None:
    program = tmp_path / "gcc"  # as gcc does, it prints the name alone of a library that it has not
    program.write_text("#!/bin/sh\necho libm.a\n")
    program.chmod(0o755)
    assert compiler._inspect(str(program)) is None


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(compiler, "program", lambda name: None)
    assert compiler.find_compiler() is None
    with pytest.raises(CompilerMissingError, match="apt-get install gcc-arm-linux-gnueabi"):
        build(tmp_path)
    with pytest.raises(CompilerMissingError):
        shared_build(cache=tmp_path)


def test_the_packages_are_installed_where_that_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    installed: list[tuple[str, ...]] = []

    def install(names: tuple[str, ...], tool: str) -> None:
        installed.append(tuple(names))

    monkeypatch.setattr(packages, "program", lambda name: "/usr/bin/gcc" if installed else None)
    monkeypatch.setattr(packages, "install_packages", install)
    assert packages.require_compiler("gcc", "a tool") is None
    assert installed == [packages.COMPILER_PACKAGES]
    assert packages.require_compiler("gcc", "a tool") is None
    assert len(installed) == 1


def test_who_may_not_install_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "program", lambda name: None)
    monkeypatch.setattr(packages, "install_packages", lambda names, tool: "on Debian, as root: apt-get ...")
    assert packages.require_compiler("gcc", "a tool") == "gcc missing; on Debian, as root: apt-get ..."
    monkeypatch.setattr(packages, "install_packages", lambda names, tool: None)
    assert "missing even with" in str(packages.require_compiler("gcc", "a tool"))
