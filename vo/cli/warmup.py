"""`vo warmup`: compile everything before the first run."""

from __future__ import annotations

import time

from vo.cli import options
from vo.cli.echo import echo


def warmup_command(
    printing: options.Printing,
) -> None:
    """Compile the inner loops now instead of in the first run.

    For container images and robots. The machine code is kept in the folder NUMBA_CACHE_DIR if
    that variable is set, else beside the package, or in the user's cache folder if the package
    cannot be written to. Other users load from NUMBA_CACHE_DIR only what root has compiled. One
    image serves all x86-64 processors with AVX2.

    Compile while a container image is built:

      vo warmup
    """
    from vo.base.compiling import store
    from vo.engine.odometry import Odometry
    from vo.engine.warmup import warm_up
    from vo.tools.rendering import rasterizer

    begin = time.monotonic()
    with printing.warnings():
        has_compiled = any([warm_up(Odometry), rasterizer.warm_up()])
    seconds, folder = time.monotonic() - begin, str(store.folder())
    record = {"compiled": has_compiled, "seconds": round(seconds, 3), "folder": folder}
    done = f"compiled in {seconds:.0f} s" if has_compiled else "nothing to compile"
    printing.show(lambda: record, lambda: echo(f"{done}; the machine code is in {folder}"))
