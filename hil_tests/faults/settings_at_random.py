"""Settings of a fault at random, from the schema that its model gives of itself."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from st_emulator.faults.catalogue import FAULTS

TIMES = ("start_s", "end_s", "duration_s")


def settings_at_random(kind: str, *, without: tuple[str, ...] = TIMES) -> st.SearchStrategy[dict[str, Any]]:
    """Tables for a fault, each key there or not."""
    schema = FAULTS[kind].settings.model_json_schema()
    keys = {
        name: _values(entry) for name, entry in schema["properties"].items() if name not in (*without, "kind")
    }
    return st.fixed_dictionaries({"kind": st.just(kind)}, optional=keys)


def _values(entry: dict[str, Any]) -> st.SearchStrategy[Any]:
    if "anyOf" in entry:
        return st.one_of(*(_values(one) for one in entry["anyOf"]))
    if "enum" in entry:
        return st.sampled_from(entry["enum"])
    if "const" in entry:
        return st.just(entry["const"])
    match entry["type"]:
        case "null":
            return st.none()
        case "boolean":
            return st.booleans()
        case "integer":
            low, high = entry.get("minimum", -(2**31)), entry.get("maximum", 2**31)
            return st.integers(low, high) | st.integers(low, min(high, low + 100))
        case "number":
            low = entry.get("minimum", entry.get("exclusiveMinimum"))
            high = entry.get("maximum", entry.get("exclusiveMaximum"))
            return st.floats(
                low, high, exclude_min="exclusiveMinimum" in entry, exclude_max="exclusiveMaximum" in entry
            )
        case "array":
            return st.lists(_values(entry["items"]), max_size=5)
    raise AssertionError(entry)
