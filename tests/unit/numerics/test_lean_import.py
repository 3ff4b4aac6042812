"""scipy is whole after its short import: its functions keep their documents, its tools are its own again."""

import subprocess
import sys

LOOK = """
import agent.numerics
import scipy.linalg
from scipy._lib import _array_api, _docscrape, _util

assert all("Parameters" in f.__doc__ for f in (scipy.linalg.qr, scipy.linalg.eigvals, scipy.linalg.svd))
assert _util.FunctionDoc is _docscrape.FunctionDoc
assert _array_api.xp_capabilities.__module__ == _array_api.__name__
"""


def test_functions_keep_their_documents_and_what_writes_documents_is_put_back() -> None:
    done = subprocess.run([sys.executable, "-c", LOOK], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
