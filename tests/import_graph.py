"""Which module imports which, read from the sources. Imports only for type checkers don't count."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import ndf_mi
import ndf_mi.plugins
import ndf_mi.stability

#: Packages by name; a checkout keeps all but the first outside of it.
FOLDERS = {
    package.__name__: Path(package.__file__).parent for package in (ndf_mi, ndf_mi.plugins, ndf_mi.stability)
}


def modules() -> dict[str, Path]:
    found = {}
    for prefix, root in FOLDERS.items():
        for file in sorted(root.rglob("*.py")):
            # The cases of the stability suite are tests, although they are installed.
            if not file.name.startswith(("test_", "conftest")):
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
            found |= {
                full if (full := f"{node.module}.{alias.name}") in MODULES else node.module
                for alias in node.names
            }
    return {module for module in found if module in MODULES} - {name}


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those below ``if TYPE_CHECKING:``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        yield node
        yield from statements(node)


GRAPH = {name: imports(name, file) for name, file in MODULES.items()}
