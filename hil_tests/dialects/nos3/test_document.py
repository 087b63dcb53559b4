"""docs/dialects/nos3.md is what the message definitions say now."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil_tests.dialects.nos3 import client
from st_emulator.dialects.nos3.definition import NOS3
from st_emulator.dialects.nos3.settings import Nos3Settings
from st_emulator.dialects.registry import dialect_named, dialect_names

DOCUMENT = Path(__file__).parents[3] / "docs" / "dialects" / "nos3.md"


def test_it_is_shipped():
    assert "nos3" in dialect_names()
    assert dialect_named("nos3") is NOS3


def test_the_document_is_fresh():
    assert NOS3.document is not None
    assert DOCUMENT.read_text(encoding="utf-8") == NOS3.document(), (
        "write it anew: python -c 'from st_emulator.dialects.nos3.definition import NOS3; "
        f'print(NOS3.document(), end="")\' > {DOCUMENT.name}'
    )


def test_it_describes_every_setting_with_its_default():
    text = DOCUMENT.read_text(encoding="utf-8")
    for name, field in Nos3Settings.model_fields.items():
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{name}` ")]
        default = str(field.default).lower() if isinstance(field.default, bool) else field.default
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert cells[2].strip('`"') == str(default)


@pytest.mark.parametrize(("layout", "name"), [key for key in client.REPLIES if key[1] != "config"])
def test_it_gives_every_reply_its_length(layout, name):
    text = DOCUMENT.read_text(encoding="utf-8")
    size = client.reply_size(name, layout)
    section = text.split(f"## Layout `{layout}`")[1].split("\n## ")[0]
    assert f"### Reply {name}, {size} octets" in section
    assert f"| {client.NUMBERS[layout][name]} " in section


def test_what_is_not_known_is_marked():
    assert DOCUMENT.read_text(encoding="utf-8").count("ASSUMED:") >= 8
