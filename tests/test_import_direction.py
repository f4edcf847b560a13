"""Which module imports which: imports run one way through the package, without circles. Imports for type checkers alone don't count."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import ndf_mi
import ndf_mi.plugins

LIBRARY, PLUGINS = Path(ndf_mi.__file__).parent, Path(ndf_mi.plugins.__file__).parent

#: Layers from the top down. A module imports from its own layer and from those below it; what is not listed is below all of them.
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


def modules() -> dict[str, Path]:
    found = {}
    for root, prefix in ((LIBRARY, "ndf_mi"), (PLUGINS, "ndf_mi.plugins")):
        for file in sorted(root.rglob("*.py")):
            parts = file.relative_to(root).with_suffix("").parts
            found[".".join((prefix, *(part for part in parts if part != "__init__")))] = file
    return found


MODULES = modules()


def imports(name: str, file: Path) -> set[str]:
    """The package's modules that a module imports, inside functions as well."""
    found: set[str] = set()
    for node in statements(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            assert node.level == 0, f"{name}: a relative import"
            # `from package import module` imports the module, and the package only to find it.
            found |= {full if (full := f"{node.module}.{alias.name}") in MODULES else node.module for alias in node.names}
    return {module for module in found if module in MODULES} - {name}


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those below ``if TYPE_CHECKING:``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        yield node
        yield from statements(node)


GRAPH = {name: imports(name, file) for name, file in MODULES.items()}


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
