"""How the array engine is set up before it is first used."""

from __future__ import annotations

import os
from pathlib import Path

import jax
from threadpoolctl import threadpool_limits


def prepare_engine() -> None:
    """Double precision, and one thread for a single robot: its arrays are so small that a second thread only waits.

    On two cores a turn-over computes 1.5 times as fast with one thread, and does not suffer from what else runs there.
    `NPROC` is what the engine reads for the size of its thread pool: set it yourself to have more. Without effect on
    the engine once it has computed something.
    """
    os.environ.setdefault("NPROC", "1")
    # Libraries that are loaded later read this.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", os.environ["NPROC"])
    threadpool_limits(limits=int(os.environ["NPROC"]), user_api="blas")  # the engine's factorisations go there
    # Setting up is always done in double precision; a scenario's single precision is a choice for the run.
    jax.config.update("jax_enable_x64", True)


def keep_compiled() -> None:
    """Keep compiled programs for the next time, in `JAX_COMPILATION_CACHE_DIR` or else the user's cache folder.

    A run of the same body and programme then begins in a second or two instead of ten. A folder that cannot be made is
    no error: then everything is compiled anew.
    """
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
        folder = Path(home) / "gelbot" / "compiled"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return
        jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
