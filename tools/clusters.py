"""Where many recordings are worked on: all cores of this machine, or a Dask cluster."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from galen_hw.errors import UsageError


@contextmanager
def cluster(address: str | None) -> Iterator[dict[str, Any]]:
    """Arguments of `joblib.parallel_config`.

    Raises:
        UsageError: dask is not installed, or no scheduler answers.
    """
    if address is None:
        yield {"backend": "loky", "n_jobs": -1, "inner_max_num_threads": 1}
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("dask is not installed", where="--dask", todo="pip install 'galen-hw[dask]'") from error
    connect: Any = Client  # its signature carries no types
    try:
        client = connect(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        todo = "start one with dask scheduler, or leave --dask out"
        raise UsageError(f"no scheduler answers ({error})", where=f"--dask {address}", todo=todo) from error
    try:
        yield {"backend": "dask"}
    finally:
        client.close()
