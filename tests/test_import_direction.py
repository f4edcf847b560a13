"""Which module imports which: imports run one way through the package, without circles. Imports for type
checkers alone don't count.
"""

from __future__ import annotations

from import_graph import GRAPH

#: Layers from the top down. A module imports from its own layer and from those below it; what is not listed
#: is below all of them.
LAYERS = (
    ("commands",),
    ("experiments", "reports", "stability"),
    ("methods",),
    ("learn", "animate"),
    ("plugins",),
    ("render",),
    ("surface", "model", "coordinates", "run", "capture", "planning"),
    ("field", "projection"),
    ("body",),
)
LEVEL = {part: len(LAYERS) - i for i, layer in enumerate(LAYERS) for part in layer}


def part(name: str) -> str:
    return name.split(".")[1] if "." in name else ""


def test_no_module_imports_one_that_imports_it() -> None:
    circles = [component for component in strongly_connected(GRAPH) if len(component) > 1]
    assert circles == []


def test_imports_run_one_way() -> None:
    upward = {(name, other) for name, others in GRAPH.items() for other in others
              if part(name) != part(other) and LEVEL.get(part(other), 0) > LEVEL.get(part(name), 0)
              and part(name) not in ("", "doctor")}
    assert upward == set()


def strongly_connected(graph: dict[str, set[str]]) -> list[list[str]]:
    """The strongly connected components of a directed graph (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            cut = stack.index(node)
            found.append(sorted(stack[cut:]))
            del stack[cut:]

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found
