"""What makes the loop steady: real-time priority where permitted, exact timers, garbage collected when we say so."""

import contextlib
import ctypes
import gc
import os
import resource
import time
from typing import Final

import zmq

_PR_SET_TIMERSLACK: Final = 29


def raise_priority(priority: int) -> bool:
    """Run this process under SCHED_FIFO (0: leave it); False where that is not permitted.

    Threads made later, ZeroMQ's too, inherit it. The kernel leaves 5 % of a core to others even so
    (sched_rt_runtime_us), and RLIMIT_RTTIME ends a loop that runs wild for ten seconds.
    """
    if priority == 0:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_RTTIME, (10_000_000, 10_000_000))
    return True


def share_one_core(priority: int) -> None:
    """Keep this process on one core with ZeroMQ's thread above the loop; after `raise_priority`, and before any socket.

    A sample is sent by ZeroMQ's thread. Where that wakes on another core, both pay for the call across and for what the other's
    caches do not hold; here it interrupts the loop at once, and the loop goes on when it has sent. It gets the priority that is
    permitted and the loop one less, for ZeroMQ ends the process where its thread may not have what it was told.

    The last of the cores that the process may have (`CPUAffinity` of the unit): most interrupts come to the first.

    Args:
        priority: that `raise_priority` was permitted.
    """
    cores = os.sched_getaffinity(0)
    if priority < 2 or len(cores) < 2:
        return
    with contextlib.suppress(OSError, zmq.ZMQError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority - 1))
        os.sched_setaffinity(0, {max(cores)})
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        context.set(zmq.THREAD_SCHED_POLICY, os.SCHED_FIFO)
        context.set(zmq.THREAD_PRIORITY, priority)


def sharpen_timers() -> None:
    """Let waits end within a microsecond of their time instead of fifty (timer slack of ordinary threads)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


class GarbageKeeper:
    """Collects garbage at times of our choosing; what was made at the start is never looked at again.

    Args:
        interval_s: between collections; measured well below a millisecond each, see docs/benchmarks.md.
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_ns = round(interval_s * 1e9)
        self._next_ns = time.monotonic_ns() + self._interval_ns
        gc.collect()
        gc.freeze()
        gc.disable()

    def collect(self, now_ns: int) -> None:
        """Collect if it is time."""
        if now_ns >= self._next_ns:
            gc.collect()
            self._next_ns = now_ns + self._interval_ns
