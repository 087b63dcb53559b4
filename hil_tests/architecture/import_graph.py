"""Which file of ours loads which, over all paths: what one import draws in, and circles.

An edge is an import anywhere in a file, in a function or for type checkers alone as well: whoever reads the
one file needs the other. A package's ``__init__`` is loaded with each of its modules.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache

from hil_tests.architecture.source_tree import Source, sources

Graph = Mapping[str, frozenset[str]]


def graph_of(found: tuple[Source, ...]) -> dict[str, frozenset[str]]:
    """Module to the modules of ours that it imports. A package's own ``__init__`` counts for what lies below
    it only where it imports something itself.
    """
    modules = {source.module for source in found}
    graph: dict[str, frozenset[str]] = {}
    for source in found:
        names = set()
        for name in source.imports():
            while name and name not in modules:  # a name in a module
                name = name.rpartition(".")[0]
            if name:
                names.add(name)
                names |= {parent for parent in _parents(name) if parent in modules}
        graph[source.module] = frozenset(names - {source.module} - set(_parents(source.module)))
    return graph


def _parents(module: str) -> Iterator[str]:
    while "." in module:
        module = module.rpartition(".")[0]
        yield module


@cache
def import_graph() -> dict[str, frozenset[str]]:
    """Of all sources."""
    return graph_of(sources())


def path_to(graph: Graph, start: str, target: str) -> list[str]:
    """A shortest chain of imports from one module to another, both included; empty when there is none."""
    paths = {start: [start]}
    waiting = [start]
    while waiting:
        module = waiting.pop(0)
        if module == target and module != start:
            return paths[module]
        for name in sorted(graph.get(module, ())):
            if name not in paths:
                paths[name] = [*paths[module], name]
                waiting.append(name)
    return []


def reached(graph: Graph, start: str) -> frozenset[str]:
    """Every module that an import of ``start`` draws in, over all paths."""
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        for name in graph.get(waiting.pop(), ()):
            if name not in seen:
                seen.add(name)
                waiting.append(name)
    return frozenset(seen)


def circles(graph: Graph) -> list[list[str]]:
    """The groups of modules that draw in each other (strongly connected, Tarjan 1972), sorted."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for name in graph.get(module, ()):
            if name not in index:
                visit(name)
                low[module] = min(low[module], low[name])
            elif name in stack:
                low[module] = min(low[module], index[name])
        if low[module] == index[module]:
            place = stack.index(module)
            group = stack[place:]
            del stack[place:]
            if len(group) > 1:
                found.append(sorted(group))

    for module in graph:
        if module not in index:
            visit(module)
    return sorted(found)
