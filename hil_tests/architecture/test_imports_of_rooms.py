"""The wall, along all imports: what a room draws in, directly and through others."""

from __future__ import annotations

import pytest

from hil_tests.architecture.import_graph import Graph, circles, graph_of, import_graph, path_to, reached
from hil_tests.architecture.source_tree import is_in, sources

P = "st_emulator."
VOCABULARY = tuple(f"{P}firmware_model.{name}" for name in ("modes", "reasons", "causes", "parameter_table"))
LEAVES = (f"{P}clock", f"{P}errors", f"{P}compiled_kernels")
#: What a room may draw in, over all paths, besides itself. Only what is here is allowed.
MAY_REACH: dict[str, tuple[str, ...]] = {
    "protocol": VOCABULARY,
    "firmware_model": (),
    "world": (),
    "links": (f"{P}protocol", *VOCABULARY),
    "units": (f"{P}protocol", *VOCABULARY, *LEAVES),
    "device": (f"{P}firmware_model", f"{P}units", f"{P}protocol", *LEAVES),
    "wire": (f"{P}protocol", f"{P}units", *VOCABULARY, *LEAVES),
    "dialects": (
        f"{P}device", f"{P}firmware_model", f"{P}protocol", f"{P}wire", f"{P}units", f"{P}naming", f"{P}tai",
        *LEAVES,
    ),
    "obc": (
        f"{P}protocol", f"{P}links", f"{P}units", f"{P}naming", f"{P}tai", f"{P}report", *VOCABULARY, *LEAVES,
    ),
    "faults": (
        f"{P}device", f"{P}firmware_model", f"{P}protocol", f"{P}wire", f"{P}units", f"{P}world", *LEAVES,
    ),
    "bench": (
        f"{P}device", f"{P}dialects", f"{P}faults", f"{P}firmware_model", f"{P}protocol", f"{P}wire",
        f"{P}units", f"{P}world", f"{P}naming", f"{P}tai", *LEAVES,
    ),
    "drivers": (
        f"{P}bench", f"{P}links", f"{P}device", f"{P}dialects", f"{P}faults", f"{P}firmware_model",
        f"{P}protocol", f"{P}wire", f"{P}units", f"{P}world", f"{P}naming", f"{P}tai", *LEAVES,
    ),
}  # fmt: skip
#: What a room may import itself, where that is less than what it may reach through others.
MAY_IMPORT: dict[str, tuple[str, ...]] = {
    "device": (f"{P}firmware_model", f"{P}units", *LEAVES),
    "wire": (f"{P}protocol", f"{P}units.can_section", *LEAVES),
}
#: Modules that stand above their room: they join what rooms keep apart.
ABOVE: tuple[str, ...] = (f"{P}bench.joined",)
#: Nothing imports these.
TOPS = (f"{P}commands", f"{P}cli", f"{P}__main__", "hil_tests", "tools")


def modules_of(room: str, graph: Graph) -> list[str]:
    found = [module for module in graph if is_in(module, P + room) and module not in ABOVE]
    assert found, room
    return found


def packages(allowed: tuple[str, ...]) -> set[str]:
    """The packages round what is allowed: their ``__init__`` comes along."""
    found = {"st_emulator"}
    for name in allowed:
        while "." in name:
            name = name.rpartition(".")[0]
            found.add(name)
    return found


def forbidden(room: str, graph: Graph) -> list[str]:
    """Chains of imports that lead out of a room to where it must not look."""
    allowed = (P + room, *MAY_REACH[room])
    around = packages(allowed)
    return [
        " -> ".join(path_to(graph, module, name))
        for module in modules_of(room, graph)
        for name in sorted(reached(graph, module))
        if not is_in(name, *allowed) and name not in around
    ]


@pytest.mark.parametrize("room", MAY_REACH)
def test_a_room_draws_in_what_it_may(room: str) -> None:
    assert forbidden(room, import_graph()) == []


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_imports_what_it_may(room: str) -> None:
    allowed = (P + room, *MAY_IMPORT[room])
    around = packages(allowed)
    graph = import_graph()
    found = {(m, n) for m in modules_of(room, graph) for n in graph[m]}
    assert {(m, n) for m, n in found if not is_in(n, *allowed) and n not in around} == set()


def test_every_room_has_its_rule() -> None:
    rooms = {
        module.split(".")[1] for module in import_graph() if module.count(".") >= 2 and module.startswith(P)
    }
    assert rooms == set(MAY_REACH) | {"commands", "campaigns", "budget"}


def test_packages_round_what_is_allowed_import_nothing_themselves() -> None:
    """So that the rules above may pass over them."""
    graph = import_graph()
    for room, allowed in MAY_REACH.items():
        for package in packages(allowed):
            if package in graph and not is_in(package, P + room, *allowed):
                assert graph[package] == frozenset(), package


def test_there_are_no_circles() -> None:
    assert circles(import_graph()) == []


def test_nothing_imports_the_top() -> None:
    graph = import_graph()
    for module, names in graph.items():
        if not is_in(module, *TOPS, f"{P}campaigns", f"{P}budget"):
            assert [name for name in names if is_in(name, *TOPS)] == [], module


def test_the_device_never_sees_the_truth() -> None:
    graph = import_graph()
    truth = (f"{P}world", f"{P}bench", f"{P}campaigns", f"{P}commands", f"{P}obc", f"{P}dialects", f"{P}wire")
    for module in [*modules_of("device", graph), *modules_of("firmware_model", graph)]:
        assert [name for name in reached(graph, module) if is_in(name, *truth)] == []


# -- that the tests can fail

#: An import put in where it must not be: (importing module, imported module, room, the chain that is shown).
PUT_IN = [
    ("device.parameters", "bench.scenario", "device", "star_tracker -> device.parameters -> bench.scenario"),
    ("device.calibration", "world.camera", "device", "parameters -> device.calibration -> world.camera"),
    ("units.validation", "world.stars", "device", "units.profile -> units.validation -> world.stars"),
    ("device.store", "dialects.pus.dialect", "device", "device.store -> dialects.pus.dialect"),
    ("firmware_model.tracking", "protocol.framing", "firmware_model", "tracking -> protocol.framing"),
    ("protocol.framing", "clock", "protocol", "protocol.framing -> clock"),
    ("naming", "device.imaging", "obc", "naming -> device.imaging"),
    ("dialects.pus.verification", "world.scene", "dialects", "dialects.pus.verification -> world.scene"),
    ("wire.port", "device.commands", "wire", "wire.port -> device.commands"),
    ("bench.journal", "obc.client", "bench", "bench.journal -> obc.client"),
]  # fmt: skip


def short(chain: str) -> str:
    return chain.replace("st_emulator.", "").replace("firmware_model.tracking", "tracking")


@pytest.mark.parametrize(("importing", "imported", "room", "chain"), PUT_IN)
def test_a_forbidden_import_is_found(importing: str, imported: str, room: str, chain: str) -> None:
    graph = dict(import_graph())
    assert P + importing in graph
    assert P + imported in graph
    graph[P + importing] = graph[P + importing] | {P + imported}
    found = [short(path) for path in forbidden(room, graph)]
    assert any(chain in path for path in found), found[:5]


def test_a_circle_is_found() -> None:
    graph = dict(import_graph())
    graph[f"{P}device.imaging"] = graph[f"{P}device.imaging"] | {f"{P}device.star_tracker"}
    (circle,) = circles(graph)
    assert {f"{P}device.imaging", f"{P}device.star_tracker"} <= set(circle)


def test_the_graph_is_that_of_the_sources() -> None:
    graph = graph_of(sources())
    assert f"{P}device.star_tracker" in graph[f"{P}bench.emulator"]
    assert path_to(graph, f"{P}cli", f"{P}world.scene")
    assert path_to(graph, f"{P}world.scene", f"{P}cli") == []
