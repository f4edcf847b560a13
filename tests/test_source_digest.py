"""Digests of the package's sources."""

import pytest

from ndf_mi.source_digest import code_digest, sources_digest


def test_digests_depend_on_the_sources_named():
    assert code_digest() == code_digest()
    digests = {
        sources_digest(*names)
        for names in (("model.py",), ("run.py",), ("render",), ("plugins",), ("model.py", "run.py"))
    }
    assert len(digests) == 5


def test_sources_must_exist():
    with pytest.raises(FileNotFoundError):
        sources_digest("no_such_module.py")
