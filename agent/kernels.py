"""Which kernels OpenBLAS multiplies with; asked before anything imports numpy, which reads it then."""

import os
from pathlib import Path

PROCESSOR = Path("/proc/cpuinfo")


def settled(processor: Path = PROCESSOR) -> dict[str, str]:
    """Return variables for one BLAS thread, and for AVX2 on processors that have more; those set stay.

    Small products are ten times slower on two threads. Kernels for AVX-512 add in another order for other
    sizes: rows would depend, by some millionths of an sd, on the processor and on how samples arrive.
    """
    wanted = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    if processor.exists() and "avx512f" in processor.read_text(encoding="utf-8"):
        wanted["OPENBLAS_CORETYPE"] = "Haswell"
    return {name: os.environ.get(name, value) for name, value in wanted.items()}
