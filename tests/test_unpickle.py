"""The restricted unpickler: arrays of every kind come back as they were put in; whatever else is named ends
the reading.
"""

from __future__ import annotations

import collections
import io
import os
import pickle
import sys
import time
import tracemalloc
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from ndf_mi import unpickle
from ndf_mi.errors import InputError


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def chumpy(monkeypatch: pytest.MonkeyPatch) -> tuple[type, type]:
    """Classes with the names and the stored attributes of chumpy's, so that real pickles of them can be
    written.
    """
    ch, reordering = types.ModuleType("chumpy.ch"), types.ModuleType("chumpy.reordering")
    monkeypatch.setitem(sys.modules, "chumpy", types.ModuleType("chumpy"))
    kinds = []
    for module, name in ((ch, "Ch"), (reordering, "Select")):
        kind = type(name, (), {"__module__": module.__name__})
        setattr(module, name, kind)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        kinds.append(kind)
    return kinds[0], kinds[1]


def made(kind: type, **attributes: Any) -> Any:
    result = kind()
    result.__dict__.update(attributes)
    return result


ARRAYS = {
    "float32": np.arange(6, dtype=np.float32).reshape(2, 3),
    "big-endian": np.arange(6, dtype=">f8").reshape(3, 2),
    "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
    "no values": np.zeros((0, 3)),
    "one value": np.array(3.5),
    "bool": np.array([True, False]),
    "uint32": np.array([2**32 - 1, 0], dtype=np.uint32),
    "text": np.array(["ab", "c"]),
}


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays(tmp_path: Path, name: str, protocol: int) -> None:
    array = ARRAYS[name]
    held = {"a": array, "twice": [array, (array, None)], "number": np.float64(2.5), "whole": 7}
    found = unpickle.load_pickle(write(tmp_path / "a.pkl", pickle.dumps(held, protocol)))
    np.testing.assert_array_equal(found["a"], array)
    assert found["a"].dtype == array.dtype.newbyteorder("=") and found["a"].flags.writeable
    assert found["twice"][0] is found["a"] and found["twice"][1] == (found["a"], None)
    assert found["number"] == 2.5 and found["whole"] == 7


def test_names_of_both_numpys(tmp_path: Path) -> None:
    data = pickle.dumps(np.arange(3.0), 2)
    new, old = b"numpy._core.multiarray", b"numpy.core.multiarray"
    assert new in data or old in data
    for name in (new, old):
        found = unpickle.load_pickle(write(tmp_path / "a.pkl", data.replace(new, name).replace(old, name)))
        np.testing.assert_array_equal(found, [0, 1, 2])


# What Python 2's pickle.dumps({'a': np.array([1.5, -2.0]), 'k': 'caf\xe9'}, protocol) wrote, put down by hand
# from its opcodes.
PYTHON_2 = {
    0: b"(dp0\nS'a'\np1\ncnumpy.core.multiarray\n_reconstruct\np2\n(cnumpy\nndarray\np3\n(I0\ntp4\nS'b'\np5\ntp6\nRp7\n"  # noqa: E501
       b"(I1\n(L2L\ntp8\ncnumpy\ndtype\np9\n(S'f8'\np10\nI0\nI1\ntp11\nRp12\n(I3\nS'<'\np13\nNNNI-1\nI-1\nI0\ntp14\nbI00\n"  # noqa: E501
       b"S'\\x00\\x00\\x00\\x00\\x00\\x00\\xf8?\\x00\\x00\\x00\\x00\\x00\\x00\\x00\\xc0'\np15\ntp16\nbsS'k'\np17\nS'caf\\xe9'\np18\ns.",  # noqa: E501
    2: b"\x80\x02}q\x00(U\x01aq\x01cnumpy.core.multiarray\n_reconstruct\nq\x02cnumpy\nndarray\nq\x03K\x00\x85U\x01b\x87Rq\x04"  # noqa: E501
       b"(K\x01K\x02\x85cnumpy\ndtype\nq\x05U\x02f8K\x00K\x01\x87Rq\x06(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89"  # noqa: E501
       b"U\x10\x00\x00\x00\x00\x00\x00\xf8?\x00\x00\x00\x00\x00\x00\x00\xc0tbU\x01kU\x04caf\xe9u.",
}  # fmt: skip


@pytest.mark.parametrize("protocol", PYTHON_2)
def test_python_2(tmp_path: Path, protocol: int) -> None:
    found = unpickle.load_pickle(write(tmp_path / "a.pkl", PYTHON_2[protocol]))
    np.testing.assert_array_equal(found["a"], [1.5, -2.0])
    assert found["k"] == "café"


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("form", ["csc_matrix", "csr_matrix", "coo_matrix", "csc_array", "coo_array"])
def test_sparse(tmp_path: Path, form: str, protocol: int) -> None:
    dense = np.where(np.random.default_rng(0).random((4, 7)) < 0.4, np.arange(28.0).reshape(4, 7), 0)
    data = pickle.dumps({"m": getattr(sparse, form)(dense)}, protocol)
    found = unpickle.load_pickle(write(tmp_path / "a.pkl", data))["m"]
    assert sparse.issparse(found) and found.format == form[:3]
    np.testing.assert_array_equal(found.toarray(), dense)
    # Where older versions of scipy keep the class.
    if protocol < 4:
        old = data.replace(f"scipy.sparse._{form[:3]}".encode(), f"scipy.sparse.{form[:3]}".encode())
        assert old != data
        np.testing.assert_array_equal(unpickle.load_pickle(write(tmp_path / "b.pkl", old))["m"].toarray(),
                                      dense)


@pytest.mark.parametrize("protocol", range(6))
def test_chumpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: int) -> None:
    """The array alone is kept: other attributes may hold what they will, an array among them that refers
    back.
    """
    ch, select = chumpy(monkeypatch)
    values = np.arange(24.0).reshape(2, 3, 4)
    leaf = made(ch, x=values, _dirty_vars={"x"}, _itr=None)
    leaf._parent = leaf
    part = made(select, a=leaf, idxs=np.array([0, 1, 4, 5]), preferred_shape=np.array([2, 2]), _cache={})
    flat = made(select, a=leaf, idxs=np.array([23, 0]))
    data = pickle.dumps({"leaf": leaf, "part": part, "flat": flat}, protocol)
    monkeypatch.undo()
    assert "chumpy.ch" not in sys.modules
    found = unpickle.load_pickle(write(tmp_path / "a.pkl", data))
    np.testing.assert_array_equal(found["leaf"], values)
    np.testing.assert_array_equal(found["part"], [[0, 1], [4, 5]])
    np.testing.assert_array_equal(found["flat"], [23, 0])
    assert "chumpy" not in sys.modules


def test_ordered_dict(tmp_path: Path) -> None:
    held = collections.OrderedDict(b=np.arange(2), a=1)
    found = unpickle.load_pickle(write(tmp_path / "a.pkl", pickle.dumps(held)))
    assert list(found) == ["b", "a"] and found["b"].tolist() == [0, 1]


#: In the place of {'descr': '<i8', 'fortran_order': False, 'shape': (9,), }
HEADERS = [b"{'descr': '<i8', 'fortran_order': False, 'shape': (9,), ",
           b"{'descr': (), 'fortran_order': False, 'shape': (9,)}",
           b"{'descr': '<i8', 'fortran_order': False, 'shape': (99999999999999999999999,)}"]  # fmt: skip


class TestNpy:
    def test_object(self, tmp_path: Path) -> None:
        path = tmp_path / "annots.npy"
        np.save(path, {"cams": {"K": [np.eye(3), np.zeros(2)]}, "ims": [{"ims": ["a/0.jpg"]}]},
                allow_pickle=True)
        found = unpickle.load_npy(path)
        np.testing.assert_array_equal(found["cams"]["K"][0], np.eye(3))
        assert found["ims"] == [{"ims": ["a/0.jpg"]}]

    def test_list_of_objects(self, tmp_path: Path) -> None:
        held = np.empty((2, 1), dtype=object)
        held[:, 0] = [np.arange(3), "text"]
        np.save(tmp_path / "a.npy", held, allow_pickle=True)
        found = unpickle.load_npy(tmp_path / "a.npy")
        assert found.shape == (2, 1) and found[1, 0] == "text" and found[0, 0].tolist() == [0, 1, 2]

    def test_plain(self, tmp_path: Path) -> None:
        np.save(tmp_path / "a.npy", np.arange(6.0).reshape(2, 3))
        np.testing.assert_array_equal(unpickle.load_npy(tmp_path / "a.npy"), [[0, 1, 2], [3, 4, 5]])

    @pytest.mark.parametrize("keep", [0, 5, 40, 130, -1])
    @pytest.mark.parametrize("objects", [False, True])
    def test_truncated(self, tmp_path: Path, keep: int, objects: bool) -> None:
        np.save(tmp_path / "a.npy", {"a": np.arange(9)} if objects else np.arange(9), allow_pickle=True)
        write(tmp_path / "a.npy", (tmp_path / "a.npy").read_bytes()[:keep])
        with pytest.raises(InputError, match="a.npy: found a damaged or truncated"):
            unpickle.load_npy(tmp_path / "a.npy")

    @pytest.mark.parametrize("header", HEADERS)
    def test_damaged_headers(self, tmp_path: Path, header: bytes) -> None:
        """Whatever numpy's reader of headers ends in: TokenError, IndexError, OverflowError."""
        np.save(tmp_path / "a.npy", np.arange(9))
        whole = (tmp_path / "a.npy").read_bytes()
        write(tmp_path / "a.npy", whole[:10] + header.ljust(117) + b"\n" + whole[128:])
        with pytest.raises(InputError, match="a.npy: found a damaged or truncated"):
            unpickle.load_npy(tmp_path / "a.npy")

    def test_npz(self, tmp_path: Path) -> None:
        held = np.empty((), dtype=object)
        held[()] = sparse.csc_matrix(np.eye(2))
        np.savez(tmp_path / "a.npz", plain=np.arange(3), pickled=held, other=1)
        found = unpickle.load_npz(tmp_path / "a.npz", ("plain", "pickled", "absent"))
        assert set(found) == {"plain", "pickled"} and found["pickled"].toarray().tolist() == [[1, 0], [0, 1]]

    def test_npz_that_unpacks_to_much(self, tmp_path: Path) -> None:
        np.savez_compressed(tmp_path / "a.npz", zeros=np.zeros(2**24, dtype=np.float64))
        with pytest.raises(InputError, match="a.npz: zeros: found .*times"):
            unpickle.load_npz(tmp_path / "a.npz", ("zeros",))

    def test_no_npz(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="a.npz: found a damaged"):
            unpickle.load_npz(write(tmp_path / "a.npz", b"PK\x03\x04 no"), ("a",))


class Calls:
    """Pickles as a call of ``function``."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> Any:
        return self.call


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize(("function", "arguments", "name"), [
    (os.system, ("touch PATH",), "system"),
    (eval, ("open('PATH', 'w')",), "eval"),
    (getattr, (str, "upper"), "getattr"),
    (open, ("PATH", "w"), "open"),
    (np.load, ("PATH",), "load"),
    (np.frombuffer, (b"",), "frombuffer"),
    (collections.defaultdict, (list,), "defaultdict"),
])  # fmt: skip
def test_another_name_is_refused_and_not_run(tmp_path: Path, function: Any, arguments: Any, name: str,
                                             protocol: int) -> None:
    target = tmp_path / "touched"
    arguments = tuple(a.replace("PATH", str(target)) if isinstance(a, str) else a for a in arguments)
    data = pickle.dumps({"v_template": Calls(function, *arguments)}, protocol)
    path = write(tmp_path / "model.pkl", data)
    with pytest.raises(InputError, match=rf"model.pkl: found a pickle that names [\w.]*{name}") as raised:
        unpickle.load_pickle(path)
    assert "has been run" in raised.value.repair and not target.exists()
    held = io.BytesIO()
    np.lib.format.write_array_header_1_0(held, {"descr": "|O", "fortran_order": False, "shape": ()})
    with pytest.raises(InputError, match=rf"annots.npy: found a pickle that names [\w.]*{name}"):
        unpickle.load_npy(write(tmp_path / "annots.npy", held.getvalue() + data))
    assert not target.exists()


def reduced(data: Any, dtype: str = "f8", shape: Any = (2,)) -> bytes:
    """The pickle of an array whose state does not fit its data."""
    state = (1, shape, Calls(np.dtype, dtype), False, data)

    class Array:
        def __reduce__(self) -> Any:
            return np.zeros(0).__reduce__()[0], (np.ndarray, (0,), b"b"), state

    return pickle.dumps(Array(), 2)


MALFORMED = {
    "data too short": (reduced(b"12345678"), "another size"),
    "a shape that is huge": (reduced(b"12345678", shape=(2**39,)), "another size"),
    "a negative shape": (reduced(b"", shape=(-1,)), "without a shape"),
    "a structured type": (reduced(b"", dtype="f8,f8"), "not of numbers"),
    "objects from bytes": (reduced(b"1234567812345678", dtype="O"), "another number of objects"),
    "a class as a value": (b"\x80\x02cnumpy\ndtype\n.", "a class in place"),
    "a list that holds itself": (b"\x80\x02]q\x00h\x00a.", "contains itself"),
    "a class that is altered": (b"\x80\x02cnumpy\ndtype\n}X\x01\x00\x00\x00aK\x01sb.", "damaged"),
    "text": (b"no pickle at all", "damaged"),
    "nothing": (b"", "damaged"),
    "a persistent id": (b"Pnumber\n.", "outside the file"),
    "nested too deep": (b"]" * 200 + b"a" * 199 + b".", "nested"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed(tmp_path: Path, case: str) -> None:
    data, words = MALFORMED[case]
    with pytest.raises(InputError, match=f"a.pkl: found a .*{words}"):
        unpickle.load_pickle(write(tmp_path / "a.pkl", data))


def shared(count: int, share: bytes) -> bytes:
    """A pickle of None that `count` times becomes a container of itself, twice."""
    return b"\x80\x02N" + (b"2" + share) * count


def many_arrays(count: int) -> bytes:
    """A pickle of arrays that all take their data from the same megabyte."""
    held = bytes(2**20)
    rebuild = np.zeros(1).__reduce_ex__(5)[0]
    return pickle.dumps([Calls(rebuild, held, np.dtype("u1"), (2**20,), "C") for _ in range(count)], 5)


#: Numbers of memorised values for which the reader in C would make room, and a frame that does not follow.
HARMLESS = {
    "a large number of a memorised value": b"\x80\x02Nr\xff\xff\xff\x0f0N.",
    "the same in text": b"Np268435455\n0N.",
    "a frame of a claimed length": b"\x80\x04\x95" + (2**60).to_bytes(8, "little") + b"N.",
}

#: Hashes of tuples that share their parts, lengths and shapes that no data follow, nesting, and sharing.
HOSTILE = {
    "a shared tuple as a key": b"\x80\x02}" + shared(40, b"\x86")[2:] + b"Ns.",
    "a shared tuple as one of several keys": b"\x80\x02}(" + shared(40, b"\x86")[2:] + b"Nu.",
    "a shared tuple as a key of a dict from a list": b"\x80\x02(" + shared(40, b"\x86")[2:] + b"Nd.",
    "a shared tuple in a set": b"\x80\x04\x8f(" + shared(40, b"\x86")[2:] + b"\x90.",
    "a shared tuple in a frozen set": b"\x80\x04(" + shared(40, b"\x86")[2:] + b"\x91.",
    "shared tuples": shared(40, b"\x86") + b".",
    "shared dicts of dicts": b"\x80\x02N" + b"(K\x00h\x00d" * 2 + b".",
    "deep lists": b"]" * 200_000 + b"a" * 199_999 + b".",
    "deep tuples": b"N" + b"\x85" * 200_000 + b".",
    "bytes of a claimed length": b"\x80\x04\x8e" + (2**40).to_bytes(8, "little") + b"x.",
    "a bytearray of a claimed length": b"\x80\x05\x96" + (2**40).to_bytes(8, "little") + b"x.",
    "text of a claimed length": b"\x80\x04\x8d" + (2**40).to_bytes(8, "little") + b"x.",
    "a whole number of a claimed length": b"\x80\x02\x8b\xff\xff\xff\x7fx.",
    "arrays of the same data": many_arrays(2000),
    "a sparse matrix of a claimed shape": pickle.dumps(sparse.coo_matrix((2**31 - 1, 2**31 - 1))),
}


@pytest.mark.parametrize("case", HOSTILE | HARMLESS)
def test_short_files_that_claim_much_take_little(tmp_path: Path, case: str) -> None:
    """Most are refused, within a second and 100 MB."""
    path = write(tmp_path / "a.pkl", (HOSTILE | HARMLESS)[case])
    tracemalloc.start()
    began = time.process_time()
    if case in HARMLESS:
        assert unpickle.load_pickle(path) is None
    else:
        with pytest.raises(InputError, match=r"a\.pkl: found a .*pickle"):
            unpickle.load_pickle(path)
    seconds, (_, most) = time.process_time() - began, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6 and seconds < 5  # tracing takes most of the time


@pytest.mark.parametrize(("name", "value"), [
    ("indices", np.array([0, 1, 9])),
    ("indices", np.array([0, -1, 2])),
    ("indices", np.array([0.0, 1.0, 2.0])),
    ("indptr", np.array([0, 5, 2, 3])),
    ("indptr", np.array([0, 1, 3])),
    ("data", np.array([1.0])),
    ("data", None),
    ("_shape", (3,)),
])  # fmt: skip
def test_sparse_matrices_that_do_not_add_up(tmp_path: Path, name: str, value: Any) -> None:
    """scipy's own code would read outside its arrays."""
    matrix = sparse.csc_matrix(np.eye(3))
    matrix.__dict__[name] = value
    with pytest.raises(InputError, match="a.pkl: found a pickle with "):
        unpickle.load_pickle(write(tmp_path / "a.pkl", pickle.dumps(matrix)))


def test_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.pkl", pickle.dumps(np.zeros(1000)))
    monkeypatch.setattr(unpickle, "MOST_BYTES", 1000)
    with pytest.raises(InputError, match="a.pkl: found .* GiB"):
        unpickle.load_pickle(path)
    with pytest.raises(InputError, match="b.pkl: found no such file"):
        unpickle.load_pickle(tmp_path / "b.pkl")
