"""Many recordings, each by whichever process is free: of this machine, or of a Dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from galen_hw.errors import UsageError

One = TypeVar("One")
Found = TypeVar("Found")


def on_this_machine(do: Callable[[One], Found], items: Sequence[One]) -> Iterator[Found]:
    """Yield what a function answers to each item, in the order in which the answers come; a process a core."""
    from joblib import Parallel, delayed, parallel_config

    with parallel_config(backend="loky", n_jobs=-1, inner_max_num_threads=1):
        yield from Parallel(return_as="generator_unordered")(delayed(do)(item) for item in items)


def on_cluster(address: str, do: Callable[[One], Found], items: Sequence[One]) -> Iterator[Found]:
    """Yield the same from a Dask cluster; an item whose worker dies is taken up by another worker.

    Not by joblib's back-end: where the cluster has one thread it does all the work here, in the client, and its answers
    come all together at the end.

    Raises:
        UsageError: dask is not installed, no scheduler answers, or every worker that took an item up died of it.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise UsageError("dask is not installed", where="--dask", todo="pip install 'galen-hw[dask]'") from error
    connect: Any = Client  # neither carries types
    as_ended: Any = as_completed
    try:
        client = connect(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        todo = "start one with dask scheduler, or leave --dask out"
        raise UsageError(f"no scheduler answers ({error})", where=f"--dask {address}", todo=todo) from error
    with client:
        asked = {client.submit(do, item, pure=False): item for item in items}
        try:
            for future in as_ended(asked):
                try:
                    yield future.result()
                except KilledWorker as error:
                    todo = "see the workers' logs; for want of memory: fewer threads a worker"
                    raise UsageError(
                        "every worker that took it up has died", where=str(asked[future]), todo=todo
                    ) from error
        finally:
            client.cancel(list(asked))
