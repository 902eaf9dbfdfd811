"""The figures of one process that its `status` bears: load, memory, ages of what it publishes, load of its buses, the disk."""

import resource
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from galen_hw.clock import NS_PER_S
from galen_hw.daemon.ages import Ages
from galen_hw.daemon.port import Port

FRAME_BITS: Final = 135
"""Of a CAN frame with eight bytes at most, stuffing and the space after it included (ISO 11898-1)."""
_PAGE_BYTES: Final = resource.getpagesize()
_ZONES: Final = Path("/sys/class/thermal")


class Measures:
    """Measures from one `take` to the next.

    Args:
        disk: folder whose disk is looked at, and with it what belongs to the machine; None to leave that to another
            process.
    """

    def __init__(self, disk: Path | None) -> None:
        self._disk = disk
        self._used_s, self._at_ns = 0.0, 0
        self._frames: dict[str, int] = {}

    def take(self, now_ns: int, ages: Mapping[str, Ages], ports: Mapping[str, Port]) -> dict[str, float]:
        """All figures by name, each with its unit."""
        usage = resource.getrusage(resource.RUSAGE_SELF)
        used = usage.ru_utime + usage.ru_stime
        elapsed = max(1e-9, (now_ns - self._at_ns) / NS_PER_S)
        first, found = not self._at_ns, {"cpu_share": (used - self._used_s) / elapsed}
        self._used_s, self._at_ns = used, now_ns
        found |= _memory()
        for topic, seen in ages.items():
            if (three := seen.take()) is not None:
                found |= {f"{word} {topic}": x for word, x in zip(("p50_s", "p99_s", "worst_s"), three, strict=True)}
        for name, port in ports.items():
            if port.transport is not None and port.transport.bus_bit_rate:
                counters = port.transport.counters
                frames = counters.get("received", 0) + counters.get("sent", 0)
                bits = (frames - self._frames.get(name, frames)) * FRAME_BITS
                self._frames[name] = frames
                found[f"bus_load_share {name}"] = max(0.0, bits / elapsed / port.transport.bus_bit_rate)
        if first:
            found["cpu_share"] = 0.0
        return found | ({} if self._disk is None else _machine(self._disk))


def _memory() -> dict[str, float]:
    with suppress(OSError, ValueError, IndexError):
        return {"memory_bytes": float(int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_BYTES)}
    return {}


def _machine(folder: Path) -> dict[str, float]:
    """Free room on the disk of a folder, and the hottest sensor of the machine where it has any."""
    found = {}
    with suppress(OSError):
        there = next(p for p in (folder, *folder.absolute().parents) if p.exists())
        found["disk_free_bytes"] = float(shutil.disk_usage(there).free)
    celsius = []
    with suppress(OSError):
        for zone in _ZONES.glob("thermal_zone*/temp"):
            with suppress(OSError, ValueError):
                celsius.append(int(zone.read_text()) / 1000.0)
    return found | ({"machine_temperature_c": max(celsius)} if celsius else {})
