"""Threads of numpy's OpenBLAS, as another program of numpy sees them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import ctypes
import numpy
from vo.base.compiling.openblas import _loaded, use_one_thread, _MAPS
(path,) = [each for each in _loaded(_MAPS) if "numpy.libs" in each]
count = ctypes.CDLL(path).scipy_openblas_get_num_threads64_
use_one_thread()
print(count())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="finds libraries under Linux only")
@pytest.mark.parametrize(("given", "threads"), [(None, 1), ("2", 2)])
def test_numpy_computes_in_one_thread_unless_threads_are_given(
    given: str | None, threads: int
) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    if given is not None and (os.cpu_count() or 1) < threads:
        pytest.skip("there is one processor")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(threads)]
