"""scipy is whole after its short import: its functions keep their documents, its tools are its own again."""

import scipy.linalg
import scipy.special
from scipy._lib import _array_api, _docscrape, _util

import agent.numerics


def test_functions_keep_their_documents_and_what_writes_documents_is_put_back() -> None:
    assert agent.numerics.lean_import
    for function in (scipy.linalg.solve_banded, scipy.linalg.qr, scipy.linalg.inv, scipy.special.expit):
        assert "Parameters\n" in function.__doc__
    assert _util.FunctionDoc is _docscrape.FunctionDoc
    assert _array_api.xp_capabilities.__module__ == _array_api.__name__
