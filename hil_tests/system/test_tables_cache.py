"""The units' star tables in the cache: the same as built, mapped, never a damaged one."""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from st_emulator.bench import tables_cache
from st_emulator.bench.star_tables import star_tables
from st_emulator.bench.tables_cache import TableFigures, build_arrays, key_of, star_tables_of
from st_emulator.compiled_kernels import keep_compiled_kernels
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.units.profile import load_unit

FIGURES = TableFigures(limit_mag=3.5, epoch_jyear=2026.0, resolution_rad=1e-3, max_angle_rad=0.4)


def same(tables: StarTables, arrays: dict[str, NDArray]) -> bool:
    """Bit by bit."""
    held = tables.catalogue.to_arrays() | tables.pairs.to_arrays()
    return held.keys() == arrays.keys() and all(
        held[name].dtype == array.dtype and held[name].tobytes() == array.tobytes()
        for name, array in arrays.items()
    )


def root_of(array: NDArray) -> object:
    """What an array's memory is, behind all views."""
    base: object = array
    while isinstance(base, np.ndarray) and base.base is not None:
        base = base.base
    return base.obj if isinstance(base, memoryview) else base


@pytest.fixture(scope="module")
def built() -> dict[str, NDArray]:
    return build_arrays(FIGURES)


@pytest.fixture
def builds(monkeypatch: pytest.MonkeyPatch) -> list[TableFigures]:
    """Each building of tables is listed here."""
    calls: list[TableFigures] = []

    def counted(figures: TableFigures) -> dict[str, NDArray]:
        calls.append(figures)
        return build_arrays(figures)

    monkeypatch.setattr(tables_cache, "build_arrays", counted)
    return calls


def cached(folder: Path) -> Path:
    """The one file of a cache folder."""
    [path] = folder.iterdir()
    return path


def test_tables_are_built_once_and_then_mapped(
    tmp_path: Path, built: dict[str, NDArray], builds: list[TableFigures]
) -> None:
    assert len(built["pair_cos_angle"]) > 1000
    for _ in range(3):
        tables = star_tables_of(FIGURES, tmp_path)
        assert same(tables, built)
        for array in (tables.catalogue.unit_vectors, tables.catalogue.hip, tables.pairs.cos_angle):
            assert isinstance(root_of(array), mmap.mmap)
            assert not array.flags.writeable
            assert array.ctypes.data % 8 == 0
    assert builds == [FIGURES]


def test_a_process_that_maps_the_tables_has_no_copy_of_them(tmp_path: Path) -> None:
    """Its own (anonymous) memory grows by less than a tenth of what the tables hold."""
    figures = TableFigures(5.5, 2026.0, 1e-3, 0.4)
    star_tables_of(figures, tmp_path)
    script = (
        "import re\nfrom pathlib import Path\n"
        "from st_emulator.bench.tables_cache import TableFigures, star_tables_of\n"
        "def own_kib():\n"
        "    text = Path('/proc/self/smaps_rollup').read_text()\n"
        "    return int(re.search(r'Anonymous: *(\\d+)', text)[1])\n"
        f"before = own_kib(); tables = star_tables_of({figures!r}, Path({str(tmp_path)!r}))\n"
        "after = own_kib()\n"
        "print((after - before) * 1024, sum(a.nbytes for a in tables.arrays()))"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    grown, held = map(int, run.stdout.split())
    assert held > 2_000_000
    assert grown < held / 10


def test_a_units_tables_come_from_the_cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file that `star_tables` of a unit leaves is one that another process finds."""
    profile = load_unit("zy3")
    script = (
        "from st_emulator.bench.star_tables import star_tables\n"
        "from st_emulator.units.profile import load_unit\n"
        "from st_emulator.device.memories import digest_of\n"
        "print(digest_of(star_tables(load_unit('zy3'))).hex())"
    )
    compiled = {"NUMBA_CACHE_DIR": str(keep_compiled_kernels())}
    run = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | compiled | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    from st_emulator.device.memories import digest_of

    assert run.stdout.strip() == digest_of(star_tables(profile)).hex()
    assert len(list((tmp_path / "st-emulator").glob("tables-*.bin"))) == 1


def spots_of_damage(size: int) -> list[int]:
    """Places over the whole file, all of its prefix among them."""
    return [*range(24), *np.linspace(24, size - 1, 60).astype(int).tolist()]


def test_any_damage_is_found_and_mended(
    tmp_path: Path, built: dict[str, NDArray], builds: list[TableFigures]
) -> None:
    star_tables_of(FIGURES, tmp_path)
    path = cached(tmp_path)
    good = path.read_bytes()
    builds.clear()
    places = spots_of_damage(len(good))
    for place in places:
        path.write_bytes(good[:place] + bytes([good[place] ^ 0x10]) + good[place + 1 :])
        assert same(star_tables_of(FIGURES, tmp_path), built), place
        assert cached(tmp_path).read_bytes() == good
    assert len(builds) == len(places)


def test_a_file_cut_off_or_too_long_is_found_and_mended(
    tmp_path: Path, built: dict[str, NDArray], builds: list[TableFigures]
) -> None:
    star_tables_of(FIGURES, tmp_path)
    path = cached(tmp_path)
    good = path.read_bytes()
    builds.clear()
    damaged = [good[:length] for length in (0, 1, 23, 24, 25, 100, len(good) // 2, len(good) - 1)]
    damaged += [good + b"\0", b"\0" * len(good), b"PK\3\4" + good[4:]]
    for contents in damaged:
        path.write_bytes(contents)
        assert same(star_tables_of(FIGURES, tmp_path), built)
        assert path.read_bytes() == good
    assert len(builds) == len(damaged)


def test_other_figures_have_another_file(tmp_path: Path, builds: list[TableFigures]) -> None:
    """Even where its file is put in place of theirs."""
    star_tables_of(FIGURES, tmp_path)
    path = cached(tmp_path)
    for changed in (
        TableFigures(3.4, 2026.0, 1e-3, 0.4),
        TableFigures(3.5, 2025.0, 1e-3, 0.4),
        TableFigures(3.5, 2026.0, 1.1e-3, 0.4),
        TableFigures(3.5, 2026.0, 1e-3, 0.41),
    ):
        theirs = tmp_path / f"tables-{key_of(changed)}.bin"
        assert theirs != path
        theirs.write_bytes(path.read_bytes())
        builds.clear()
        assert same(star_tables_of(changed, tmp_path), build_arrays(changed))
        assert builds == [changed]


def test_another_program_does_not_read_what_an_older_one_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = key_of(FIGURES)
    changed = tmp_path / "pairs.py"
    original = Path(str(tables_cache.pairs.__file__))
    changed.write_bytes(original.read_bytes() + b"\n# changed\n")
    monkeypatch.setattr(tables_cache.pairs, "__file__", str(changed))
    tables_cache.builders_digest.cache_clear()
    try:
        assert key_of(FIGURES) != key
    finally:
        monkeypatch.undo()
        tables_cache.builders_digest.cache_clear()
    assert key_of(FIGURES) == key


def test_a_folder_that_cannot_be_written_is_done_without(tmp_path: Path, built: dict[str, NDArray]) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"no folder")
    tables = star_tables_of(FIGURES, file / "below")
    assert same(tables, built)
    assert not tables.pairs.cos_angle.flags.writeable


def test_processes_that_come_at_once_get_the_same_tables(tmp_path: Path, built: dict[str, NDArray]) -> None:
    """Six, while the file is damaged again and again under them; none fails, none gets other tables."""
    script = (
        "import hashlib, sys\nfrom pathlib import Path\n"
        "from st_emulator.bench.tables_cache import TableFigures, star_tables_of\n"
        "print('ready', flush=True); sys.stdin.readline()\n"
        "for _ in range(20):\n"
        f"    tables = star_tables_of({FIGURES!r}, Path({str(tmp_path)!r}))\n"
        "    print(hashlib.sha256(b''.join(a.tobytes() for a in tables.arrays())).hexdigest())\n"
    )
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(6)
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    damaged = 0
    while any(process.poll() is None for process in processes):
        for path in tmp_path.glob("tables-*.bin"):
            # a new file in place of the old one, as a copy that went wrong would leave it
            spoilt = tmp_path / "spoilt"
            spoilt.write_bytes(path.read_bytes()[:-8])
            os.replace(spoilt, path)
            damaged += 1
    said = [process.communicate()[0].split() for process in processes]
    expected = set(said[0])
    assert damaged > 0
    assert len(expected) == 1
    for process, lines in zip(processes, said, strict=True):
        assert process.returncode == 0
        assert len(lines) == 20
        assert set(lines) == expected
    assert same(star_tables_of(FIGURES, tmp_path), built)
    assert [path.suffix for path in tmp_path.iterdir()] == [".bin"]
