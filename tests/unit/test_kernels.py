"""Kernels that numpy multiplies with are those of AVX2, whatever else a processor has."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from agent.kernels import settled


@pytest.mark.parametrize(("flags", "core"), [("fma avx2 avx512f amx_tile", "Haswell"), ("fma avx2", None)])
def test_kernels_beyond_avx2_are_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: str, core: str | None
) -> None:
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    processor = tmp_path / "cpuinfo"
    processor.write_text(f"flags\t: {flags}\n", encoding="utf-8")
    assert settled(processor).get("OPENBLAS_CORETYPE") == core


def test_what_the_environment_says_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    processor = tmp_path / "cpuinfo"
    processor.write_text("flags\t: avx512f\n", encoding="utf-8")
    found = settled(processor)
    assert (found["OPENBLAS_CORETYPE"], found["OPENBLAS_NUM_THREADS"]) == ("Prescott", "3")


def test_a_command_settles_them_before_it_imports_numpy() -> None:
    program = "import sys, agent.cli.app; sys.exit('numpy' in sys.modules)"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    ended = subprocess.run([sys.executable, "-c", program], env=environment, timeout=60, check=False)
    assert ended.returncode == 0
