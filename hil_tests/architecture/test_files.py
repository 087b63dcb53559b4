"""Names and sizes of files, and what no file of the project may say."""

from __future__ import annotations

import re

import pytest

from hil_tests.architecture.source_tree import OURS, ROOT, sources, text_files

MOST_LINES = 500
EMPTY_WORDS = {"util", "utils", "helper", "helpers", "manager", "managers", "common", "misc"}
# In pieces, so that this file does not say it either.
MACHINE_PATHS = re.compile(
    r"(?<![\w.~-])/(?:" + "|".join(("wo" + "rk", "ro" + "ot", "ho" + "me", "Us" + "ers")) + r")/\w"
)
PACKAGE_HOSTS = re.compile(
    "|".join(("pypi" + r"\.org", "python" + "hosted", "artifact" + "ory", "--index" + "-url"))
)


def test_the_five_folders():
    for folder in OURS:
        assert (ROOT / folder).is_dir()
    for room in ("protocol", "firmware_model"):
        link = ROOT / "st_emulator" / room
        assert link.is_symlink()
        assert link.resolve() == ROOT / room


@pytest.mark.parametrize("source", sources(), ids=lambda source: source.path)
def test_file(source):
    assert source.lines <= MOST_LINES, "too long to be read at a sitting: it has more than one subject"
    words = set(re.split(r"[._/]", source.path.removesuffix(".py").lower()))
    assert not words & EMPTY_WORDS, "a name that says nothing"


def test_every_public_module_says_what_it_is():
    import ast

    silent = [
        source.path
        for source in sources()
        if source.tree.body
        and not source.path.startswith("hil_tests/")
        and not ast.get_docstring(source.tree)
    ]
    assert silent == []


def test_no_file_names_a_machine_or_a_package_host():
    found = []
    seen = 0
    for path, text in text_files():
        seen += 1
        for number, line in enumerate(text.splitlines(), start=1):
            if MACHINE_PATHS.search(line) or PACKAGE_HOSTS.search(line):
                found.append(f"{path}, line {number}: {line.strip()[:100]}")
    assert seen > 100
    assert found == []


def test_such_lines_would_be_found():
    assert MACHINE_PATHS.search("see /ho" + "me/me/x")
    assert MACHINE_PATHS.search('"/wo' + 'rk/main"')
    assert not MACHINE_PATHS.search("firmware_model/work/x")
    assert PACKAGE_HOSTS.search("https://pypi" + ".org/simple")


def test_no_figure_claims_more_than_it_is():
    claim = re.compile("cycle" + r"[\s_-]*" + "accura", re.IGNORECASE)
    assert claim.search("Cycle" + "-Accurate")
    assert [path for path, text in text_files() if claim.search(text)] == []
