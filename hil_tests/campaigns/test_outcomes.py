"""Outcomes as JSON and on disk: exact, and whatever is damaged counts as not there."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest

from hil_tests.campaigns.cases import Pair, pair, square
from st_emulator.campaigns.outcome_codec import decode, encode, outcome_type
from st_emulator.errors import ConfigurationError


@pytest.mark.parametrize("index", range(6))
def test_outcomes_come_back_bit_by_bit(index):
    before = pair(index)
    after = decode(outcome_type(partial(pair)), json.loads(json.dumps(encode(before))))
    assert type(after) is Pair
    for name in ("index", "share", "name", "good", "none", "mixed", "inner"):
        assert getattr(after, name) == getattr(before, name)
        assert type(getattr(after, name)) is type(getattr(before, name))
    for name in ("values", "counts"):
        assert getattr(after, name).tobytes() == getattr(before, name).tobytes()
        assert getattr(after, name).shape == getattr(before, name).shape
        assert getattr(after, name).dtype == getattr(before, name).dtype
    assert np.array_equal(after.rest, before.rest, equal_nan=True)


def test_what_has_no_json_is_refused():
    with pytest.raises(TypeError, match="set"):
        encode({1, 2})


def test_numbers_of_numpy_are_numbers():
    assert encode([np.float64(0.1), np.int32(3), np.bool_(True)]) == [0.1, 3, True]


def test_an_outcome_of_another_type_is_told():
    with pytest.raises((ValueError, TypeError)):
        decode(Pair, [1, 2])


def filled(results):
    file = results()
    file.append(0, [0, 1], [0, 1])
    file.append(0, [5, 3], [25, 9])
    file.append(1, [0], [[1.5, None]])
    return file


def test_outcomes_are_there_again(results):
    path = filled(results).path
    again = results()
    assert again.kept(0) == {0: 0, 1: 1, 5: 25, 3: 9}
    assert again.kept(1) == {0: [1.5, None]}
    assert again.kept(2) == {}
    again.append(0, [2], [4])
    assert results().kept(0) == {0: 0, 1: 1, 5: 25, 3: 9, 2: 4}
    assert len(path.read_text().splitlines()) == 5


def test_every_cut_of_the_file_leaves_the_batches_before_it(results):
    """As a power failure or a full disk may leave it; then new batches go to a line of their own."""
    path = filled(results).path
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    ends = np.cumsum([len(line) for line in lines])
    for cut in range(len(lines[0]), len(whole)):
        path.write_bytes(whole[:cut])
        file = results()
        complete = int(np.sum(ends[1:] - 1 <= cut))  # a line without its end is whole as well
        assert len(file.kept(0)) + len(file.kept(1)) == (0, 2, 4, 5)[complete], cut
        file.append(2, [7], [49])
        again = results()
        assert again.kept(2) == {7: 49}
        assert again.kept(0) == file.kept(0)


def test_damaged_batches_run_again(results):
    path = filled(results).path
    text = path.read_text()
    path.write_text(text.replace("[25,9]", "[26,9]"))
    assert results().kept(0) == {0: 0, 1: 1}
    path.write_text(text.replace('{"batch":[0,[5', 'x{"batch":[0,[5'))
    assert results().kept(0) == {0: 0, 1: 1}


def test_outcomes_of_another_campaign_are_not_mixed_in(results):
    filled(results)
    with pytest.raises(
        ConfigurationError, match=r"outcomes\.jsonl: holds another campaign's .*: seed differ"
    ):
        results({"campaign": "squares", "seed": 2})
    own = results({"campaign": "squares", "seed": 2}, named=False)
    assert own.kept(0) == {}
    assert not own.path.exists()


@pytest.mark.parametrize("contents", [b"hello\n", b"\xff\xfe", b"[]\n", b'{"format": "other"}\n', b"\n"])
def test_a_file_of_something_else_is_left_alone(results, contents, tmp_path):
    path = tmp_path / "outcomes.jsonl"
    path.write_bytes(contents)
    with pytest.raises(ConfigurationError, match=r"--results .*outcomes\.jsonl: is no file of"):
        results()
    assert path.read_bytes() == contents


def test_an_empty_file_is_a_beginning(results, tmp_path):
    (tmp_path / "outcomes.jsonl").touch()
    file = results()
    file.append(0, [1], [1])
    assert results().kept(0) == {1: 1}


def test_a_file_of_the_programs_own_goes_when_the_campaign_is_through(results):
    for named in (True, False):
        file = results(named=named)
        file.append(0, [1], [square(1)])
        assert file.path.exists()
        file.finished()
        assert file.path.exists() == named


def test_a_folder_that_cannot_be_written(results, tmp_path):
    (tmp_path / "outcomes.jsonl").mkdir()
    with pytest.raises(ConfigurationError, match="--results"):
        results()
    file = results(named=False)  # nobody asked for it: the campaign does without
    file.append(0, [1], [1])
    assert not file.usable
