"""Which kernels OpenBLAS multiplies with in tests; asked before anything imports numpy."""

import os
from pathlib import Path


def settled() -> dict[str, str]:
    """Return variables for one BLAS thread, and for AVX2 on processors that have more; those set stay.

    Small products are ten times slower on two threads. Kernels for AVX-512 add in another order, so that fits
    stop elsewhere, by some millionths of an sd: golden outputs are those of AVX2.
    """
    wanted = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    processor = Path("/proc/cpuinfo")
    if processor.exists() and "avx512f" in processor.read_text(encoding="utf-8"):
        wanted["OPENBLAS_CORETYPE"] = "Haswell"
    return {name: os.environ.get(name, value) for name, value in wanted.items()}
