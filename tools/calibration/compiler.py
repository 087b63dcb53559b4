"""The kernels of ``firmware_model/arm`` compiled for ARM926EJ-S into one program, always the same bytes."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from st_emulator.world.stars import cache_folder
from tools.vcan_guest.packages import program

__all__ = [
    "KERNELS",
    "PINNED_COMPILER",
    "Build",
    "BuildError",
    "Compiler",
    "CompilerMissingError",
    "build",
    "find_compiler",
    "shared_build",
]

KERNELS = Path(__file__).parents[2] / "firmware_model" / "arm"
COMPILER_PROGRAM = "arm-linux-gnueabi-gcc"
PINNED_COMPILER = "gcc 12.2.0 (Debian 12.2.0-14)"

PROCESSOR_FLAGS = ("-mcpu=arm926ej-s", "-marm", "-mfloat-abi=soft")
# -ffp-contract=off: each product and sum is rounded, as the Python stages' are.
COMPILE_FLAGS = (
    *PROCESSOR_FLAGS,
    "-O2",
    "-std=c11",
    "-ffp-contract=off",
    "-fno-pie",
    "-fno-stack-protector",
    "-fno-asynchronous-unwind-tables",
)
# Debug information, from which struct_layout.py reads the structs. It changes nothing of the code, and of it
# nothing is loaded or hashed; the folder of the sources is left out by -fdebug-prefix-map.
DEBUG_FLAGS = ("-g", "-gno-record-gcc-switches")
# No start files and of the C library only what the linker asks for: runtime/start.c answers for the rest.
LINK_FLAGS = (
    *PROCESSOR_FLAGS,
    "-nostdlib",
    "-static",
    "-no-pie",
    "-Wl,--build-id=none",
    "-Wl,-Ttext=0x10000",
    "-Wl,-e,_start",
    "-Wl,-z,noexecstack",
)
STRIP_DEBUG = "-Wl,--strip-debug"
LIBRARIES = ("m", "c", "gcc")
ELF_NAME = "kernels.elf"
MANIFEST_NAME = "build.json"


class CompilerMissingError(RuntimeError):
    """There is no cross compiler; the message says how to get it."""


class BuildError(RuntimeError):
    """A kernel that does not compile, or a program that does not link; the message names file and error."""


@dataclass(frozen=True)
class Compiler:
    """A cross compiler for ARM.

    version: as ``PINNED_COMPILER`` is written; pinned: that one, whose figures are committed.
    libraries: SHA-256 of each library's file by its name, as their code is in the program too.
    """

    path: str
    version: str
    pinned: bool
    libraries: dict[str, str]


@dataclass(frozen=True)
class Build:
    """A program of all kernels, with debug information.

    sha256: of the program and of each object file, both without debug information, and of each library, by
    name. flags: what decides the code.
    """

    elf: Path
    compiler: str
    flags: tuple[str, ...]
    sha256: dict[str, str]


def find_compiler() -> Compiler | None:
    """The cross compiler for ARM926EJ-S (soft float, ARMv5TE C library), None where there is none."""
    path = program(COMPILER_PROGRAM)
    return None if path is None else _inspect(path)


@cache
def _inspect(path: str) -> Compiler | None:
    line = _output(path, "--version").splitlines()[0]
    found = re.search(r"\((.*)\) (\d+\.\d+\.\d+)", line)
    version = f"gcc {found[2]} ({found[1]})" if found else line
    libraries = {}
    for name in LIBRARIES:
        file = Path(_output(path, *PROCESSOR_FLAGS, f"-print-file-name=lib{name}.a").strip())
        if not file.is_file():
            return None  # a compiler without the C library for this processor
        libraries[file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
    return Compiler(path, version, version == PINNED_COMPILER, libraries)


def build(folder: Path, *, sources: Path = KERNELS) -> Build:
    """Compile every C file under ``sources`` and link them into ``folder / kernels.elf``.

    The object files stay in ``folder / objects`` under their sources' names, and without debug information in
    ``folder / hashed`` with the program. The bytes depend on sources, compiler and its libraries alone.
    Raises CompilerMissingError; BuildError naming the file.
    """
    compiler = _require_compiler()
    files = sorted(path.relative_to(sources) for path in sources.rglob("*.c"))
    if not files:
        raise BuildError(f"no C file in {sources}")
    objects = folder / "objects"
    for file in files:
        (objects / file).parent.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        made = list(pool.map(lambda file: _compile(compiler, sources, file, objects), files))
    elf = folder / ELF_NAME
    libraries = ("-Wl,--start-group", *(f"-l{name}" for name in LIBRARIES), "-Wl,--end-group")
    names = [path.relative_to(objects).as_posix() for path in made]
    # In the objects' folder and by relative names: no path of this computer gets into the program.
    link = (*LINK_FLAGS, *names, *libraries, "-o")
    failure = "the program does not link"
    listing = f"-Wl,-Map={(folder / 'kernels.map').resolve()}"
    _run(compiler, (listing, *link, str(elf.resolve())), objects, failure)
    hashed = folder / "hashed"
    for name in names:
        (hashed / name).parent.mkdir(parents=True, exist_ok=True)
        bare = (*PROCESSOR_FLAGS, "-r", "-nostdlib", STRIP_DEBUG, name, "-o", str((hashed / name).resolve()))
        _run(compiler, bare, objects, failure)
    _run(compiler, (STRIP_DEBUG, *link, str((hashed / elf.name).resolve())), objects, failure)
    hashes = {name: _sha256(hashed / name) for name in (elf.name, *names)}
    return Build(elf, compiler.version, (*COMPILE_FLAGS, *LINK_FLAGS), hashes | compiler.libraries)


def shared_build(*, sources: Path = KERNELS, cache: Path | None = None) -> Build:
    """The program of the sources as they are, built once for all processes and kept in the user's cache.

    cache: instead of the user's cache folder. Raises as ``build``.
    """
    compiler = _require_compiler()
    folder = (cache_folder() if cache is None else cache) / "arm"
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / _key(compiler, sources)
    with _locked(folder / f"{place.name}.lock"):
        manifest = place / MANIFEST_NAME
        if not manifest.is_file():
            shutil.rmtree(place, ignore_errors=True)
            with tempfile.TemporaryDirectory(dir=folder) as work:
                made = build(Path(work) / "build", sources=sources)
                (made.elf.parent / MANIFEST_NAME).write_text(json.dumps(made.sha256), encoding="utf-8")
                made.elf.parent.rename(place)
        hashes = json.loads(manifest.read_text(encoding="utf-8"))
    return Build(place / ELF_NAME, compiler.version, (*COMPILE_FLAGS, *LINK_FLAGS), hashes)


def _require_compiler() -> Compiler:
    compiler = find_compiler()
    if compiler is None:
        raise CompilerMissingError(
            f"there is no {COMPILER_PROGRAM} with its C library; "
            "on Debian: apt-get install gcc-arm-linux-gnueabi libc6-dev-armel-cross"
        )
    return compiler


def _compile(compiler: Compiler, sources: Path, file: Path, objects: Path) -> Path:
    target = (objects / file).with_suffix(".o")
    debug = (*DEBUG_FLAGS, f"-fdebug-prefix-map={sources.resolve()}=.")
    arguments = (*COMPILE_FLAGS, *debug, "-I.", "-c", file.as_posix(), "-o", str(target.resolve()))
    _run(compiler, arguments, sources, f"{file.as_posix()} does not compile")
    return target


def _run(compiler: Compiler, arguments: Sequence[str], folder: Path, failure: str) -> None:
    done = subprocess.run(
        [compiler.path, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise BuildError(f"{failure}:\n{done.stderr.strip()}")


def _output(*line: str) -> str:
    return subprocess.run(line, capture_output=True, text=True, check=True).stdout


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _key(compiler: Compiler, sources: Path) -> str:
    """Hash of all that the program is made from, this file with its flags included."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    digest.update(json.dumps([compiler.path, compiler.version, compiler.libraries]).encode())
    for file in sorted(path for path in sources.rglob("*") if path.suffix in (".c", ".h")):
        digest.update(f"\0{file.relative_to(sources).as_posix()}\0".encode() + file.read_bytes())
    return digest.hexdigest()[:24]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One process at a time; the lock ends with the process that holds it."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
