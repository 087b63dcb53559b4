"""A journal is replayed while it is read: compressed ones, long stretches without input, refused frames."""

from __future__ import annotations

import gzip
import io
import json
import lzma
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_tests.unit.conftest import make, make_can
from st_emulator.bench.journal import JournalReader, read_journal
from st_emulator.bench.scenario import Scenario
from st_emulator.commands.replaying import Replay


def recorded(**arguments: Any) -> str:
    """Some seconds with an OBC, faults, and on CAN a link that does not take everything."""
    text = io.StringIO()
    bench = (make_can if arguments.get("can") else make)(
        journal=text, scenario=Scenario(parameters={"autonomous_start": 1})
    )
    bench.run(700)
    bench.send("ping")
    bench.emulator.faults.inject({"kind": "clock.jump", "seconds": 3.0})
    bench.run(1400)
    if arguments.get("can"):
        bench.refusing = True
        bench.run(60)
        bench.refusing = False
    number = bench.emulator.faults.inject({"kind": "line.frames_lost", "probability": 0.4})
    bench.run(1500)
    bench.emulator.faults.clear(number)
    bench.run(800)
    bench.emulator.close()
    return text.getvalue()


@pytest.fixture(scope="module", params=[False, True], ids=["serial", "can"])
def text(request: pytest.FixtureRequest) -> str:
    found = recorded(can=request.param)
    assert ('"refused"' in found) is request.param
    return found


@pytest.mark.parametrize("most", [1, 2, 7, 10_000])
def test_however_far_it_reads_ahead(text: str, most: int, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(Replay, "MOST_WAITING", most)
    path = tmp_path / "journal.jsonl"
    path.write_text(text)
    again = io.StringIO()
    reached: list[int] = []
    replay = Replay(path, again, reached.append)
    replay.run()
    assert replay.comparison.difference is None
    assert replay.comparison.tx_bytes == replay.comparison.tx_bytes_replayed > 1000
    assert again.getvalue().split("\n")[1:] == text.split("\n")[1:]
    assert reached == sorted(reached)
    assert reached[-1] == json.loads(text.splitlines()[-1])["t_ns"]


@pytest.mark.parametrize(("suffix", "opened"), [(".gz", gzip.open), (".xz", lzma.open)])
def test_a_compressed_one(
    text: str, suffix: str, opened: Callable[..., Any], tmp_path: Path, command: Any, refused: Any
) -> None:
    path, plain = tmp_path / f"journal.jsonl{suffix}", tmp_path / "journal.jsonl"
    plain.write_text(text)
    with opened(path, "wt", encoding="utf-8") as file:
        file.write(text)
    assert read_journal(path) == read_journal(plain)
    assert command("replay", path).status == 0
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])  # its writer was killed
    reader = JournalReader(path)
    lines = list(reader)
    assert 10 < len(lines) < len(text.splitlines())
    assert not reader.ended
    path.write_bytes(b"no such thing")
    refused("replay", path, says=(str(path), "cannot be read"))


def test_a_difference_is_told_where_it_is(text: str, tmp_path: Path) -> None:
    lines = text.splitlines()
    number = [n for n, line in enumerate(lines) if '"tx"' in line][40]
    item = json.loads(lines[number])
    item["tx"] = item["tx"][:-2] + ("00" if item["tx"][-2:] != "00" else "01")
    lines[number] = json.dumps(item)
    path = tmp_path / "journal.jsonl"
    path.write_text("\n".join(lines) + "\n")
    replay = Replay(path)
    replay.run()
    assert replay.comparison.difference is not None
    assert replay.comparison.difference.startswith(f"group 40 at {item['t_ns'] / 1e9:.9f} s")
