"""The registry of methods, and how a command line names them.

To add a method, write a class with the members of `ndf_mi.methods.base.Method` and register it:

    @register
    class Grey:
        key, label = "grey", "Grey"
        ...

A package makes its methods known to the command line by entry points in the group `ndf_mi.methods`, named
as the method's key: `grey = "my_package.methods:Grey"`. They are loaded when first named.

The class is created without arguments, or with those options of the experiment that its constructor has
parameters for, by name: `texture` (texels a side), `samples` (samples a ray), and what `metadata()["tuned"]`
of another training of the same method found.

On a command line, a method is KEY[:FOLDER][@BUDGET]. With a folder it is loaded from there. Without one it is
trained: `@converged` to convergence, `@equal-time` for as long as the run that it is compared with, and
without either as the experiment decides.
"""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, TypeVar

from ndf_mi.errors import InputError
from ndf_mi.methods.base import Method

CONVERGED, EQUAL_TIME = "converged", "equal-time"
BUDGETS = (CONVERGED, EQUAL_TIME)
GROUP = "ndf_mi.methods"
FORM = "KEY[:FOLDER][@converged|@equal-time]"

T = TypeVar("T", bound=type[Any])


@dataclass(frozen=True)
class Entry:
    """A registered method.

    Attributes:
        key: its name on the command line.
        factory: the class, or `module:Class`, which is imported when a method is created.
        trains: whether it can be trained; if not, it needs a folder.
    """

    key: str
    factory: Callable[..., Method] | str
    trains: bool = True

    def create(self, options: Mapping[str, Any] | None = None) -> Method:
        """A method that is neither trained nor loaded, made with those of the options that it accepts."""
        return self._make()(**self.accepted(options or {}))

    def accepted(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Those of the options that the method's constructor has parameters for."""
        parameters = inspect.signature(self._make()).parameters
        return {name: value for name, value in options.items() if name in parameters}

    def _make(self) -> Callable[..., Method]:
        return pkgutil.resolve_name(self.factory) if isinstance(self.factory, str) else self.factory


_ENTRIES = {
    "ndf": Entry("ndf", "ndf_mi.methods.ndf:NeuralField"),
    "mesh": Entry("mesh", "ndf_mi.methods.mesh:TexturedMesh"),
    "offset-mesh": Entry("offset-mesh", "ndf_mi.methods.offset_mesh:OffsetMesh"),
    "neural-body": Entry("neural-body", "ndf_mi.methods.neural_body.method:NeuralBody"),
    "animatable-nerf": Entry("animatable-nerf", "ndf_mi.methods.animatable_nerf.method:AnimatableNerf"),
    "gaussians": Entry("gaussians", "ndf_mi.methods.gaussians.method:Gaussians"),
    "images": Entry("images", "ndf_mi.methods.images:Images", trains=False),
}


def register(method: T, trains: bool = True) -> T:
    """Registers a class of methods under its `key`, in place of one that had this key before; also a class
    decorator.

    Args:
        method: the class.
        trains: whether it can be trained; if not, it must be given with a folder.
    """
    _ENTRIES[method.key] = Entry(method.key, method, trains)
    return method


def unregister(key: str) -> None:
    """Removes a method; KeyError if there is none of this key."""
    del _ENTRIES[key]


def keys() -> list[str]:
    """The keys of all methods, in the order of registration."""
    return list(_ENTRIES)


def entry(key: str) -> Entry:
    """The method of this key, if need be from an entry point.

    Raises:
        InputError: there is none, or its entry point cannot be loaded.
    """
    if key not in _ENTRIES:
        points = {point.name: point for point in entry_points(group=GROUP)}
        if key not in points:
            known = ", ".join(dict.fromkeys([*_ENTRIES, *points]))
            raise InputError("methods", repr(key) if key else "an empty name", f"one of {known}")
        _load(points[key])
    return _ENTRIES[key]


@dataclass(frozen=True)
class MethodSpec:
    """A method as the command line names it.

    Attributes:
        key: of the registry.
        folder: where it is loaded from; None if it is trained.
        budget: `converged`, `equal-time`, or None.
    """

    key: str
    folder: Path | None = None
    budget: str | None = None

    @property
    def name(self) -> str:
        """A name for files and records: the key, and the folder's or budget's name where there is one."""
        more = self.budget
        if self.folder is not None:
            more = re.sub(r"[^\w.-]", "-", self.folder.resolve().name) or "folder"
        return f"{self.key}-{more}" if more else self.key

    def __str__(self) -> str:
        folder = "" if self.folder is None else f":{self.folder}"
        return self.key + folder + ("" if self.budget is None else f"@{self.budget}")


def parse_spec(text: str) -> MethodSpec:
    """Reads KEY[:FOLDER][@BUDGET].

    Raises:
        InputError: no such method or budget, a folder with a budget, or a method that needs a folder without
            one.
    """
    head, colon, folder = text.strip().partition(":")
    head, at, budget = head.partition("@")
    known = entry(head.strip())
    if at and budget not in BUDGETS:
        raise InputError(f"method {text!r}", f"the budget {budget!r}", f"one of {', '.join(BUDGETS)}")
    if colon and (at or folder.endswith(tuple(f"@{name}" for name in BUDGETS))):
        raise InputError(f"method {text!r}", "a folder and a budget",
                         "one of the two: what a folder holds is not trained again")
    if colon and not folder:
        raise InputError(f"method {text!r}", "an empty folder name", FORM)
    if not (colon or known.trains):
        raise InputError(f"method {text!r}", "no folder", f"{known.key}:FOLDER")
    return MethodSpec(known.key, Path(folder) if colon else None, budget or None)


def parse_specs(texts: str | Iterable[str]) -> list[MethodSpec]:
    """Reads a list of methods.

    Args:
        texts: one text, with commas between methods; or one text a method, whose folder may hold a comma.

    Raises:
        InputError: as `parse_spec`; there is none, or two would have the same name in the results.
    """
    items = [item for item in texts.split(",") if item.strip()] if isinstance(texts, str) else list(texts)
    specs = [parse_spec(item) for item in items]
    if not specs:
        raise InputError("methods", "none", f"at least one of {', '.join(keys())}, as {FORM}")
    for index, spec in enumerate(specs):
        if any(spec.name == other.name for other in specs[:index]):
            raise InputError("methods", f"two named {spec.name}",
                             "methods that differ in key, budget or the folder's last name")
    return specs


def _load(point: EntryPoint) -> None:
    """Registers the class of an entry point, unless importing its module has done so."""
    where = f"method {point.name!r}, entry point {point.value}"
    try:
        method = point.load()
    except Exception as error:
        raise InputError(where, f"{type(error).__name__}: {error}", "a class that can be imported",
                         "Repair or uninstall the package that provides it.") from error
    if point.name in _ENTRIES:
        return
    if getattr(method, "key", None) != point.name:
        raise InputError(where, f"the key {getattr(method, 'key', None)!r}",
                         f"a class whose `key` is {point.name!r}")
    register(method)
