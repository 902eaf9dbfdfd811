"""The tracking replies TX (text) and BX (binary) with transforms."""

import struct
from typing import Final

from galen_hw.drivers.virtual.ndi_tracker.ports import OUT_OF_VOLUME, PARTLY_OUT, Port, Ports
from galen_hw.drivers.virtual.ndi_tracker.scene import Scene, Seen
from galen_hw.drivers.virtual.ndi_tracker.wire import OUT_OF_RANGE, NdiError, binary_reply
from galen_hw.spatial import quaternion_from_rotation

TRANSFORMS: Final = 0x0001
ALSO_OUTSIDE: Final = 0x0800
_VALID, _MISSING, _DISABLED = 1, 2, 4
_LONGEST_MM: Final = 9999.99

Numbers = tuple[list[float], list[float]]
"""(q0, qx, qy, qz) and (x, y, z) in mm."""


def options_of(parameters: str) -> int:
    """Reply options; nothing means transforms.

    Raises:
        NdiError: not four digits, or a report that this tracker does not make.
    """
    try:
        options = int(parameters or "0001", 16)
    except ValueError:
        raise NdiError(OUT_OF_RANGE) from None
    if options & ~(TRANSFORMS | ALSO_OUTSIDE) or not options & TRANSFORMS:
        raise NdiError(OUT_OF_RANGE)
    return options


def _numbers(seen: Seen) -> Numbers | None:
    """(q0, qx, qy, qz) and (x, y, z) in mm; None where they do not fit."""
    if seen.pose is None:
        return None
    x, y, z, w = quaternion_from_rotation(seen.pose[:3, :3]).tolist()
    place = (1e3 * seen.pose[:3, 3]).tolist()
    if max(abs(v) for v in place) > _LONGEST_MM:
        return None
    return [w, x, y, z], place


def _look(scene: Scene, port: Port, frame: int, options: int) -> tuple[Numbers | None, Seen, int]:
    """Numbers to report (None: missing), what was seen, port status."""
    seen = scene.see(port.marker, frame)
    status = port.status | seen.outside * OUT_OF_VOLUME | seen.partly * PARTLY_OUT
    shown = not seen.outside or bool(options & ALSO_OUTSIDE)
    return (_numbers(seen) if shown else None), seen, status


def text(ports: Ports, scene: Scene, frame: int, options: int, system_status: int) -> str:
    """TX."""
    out = f"{len(ports.by_handle):02X}"
    for port in ports.by_handle.values():
        out += f"{port.handle:02X}"
        if not port.enabled:
            out += f"DISABLED{port.status:08X}{max(frame, 0):08X}\n"
            continue
        numbers, seen, status = _look(scene, port, frame, options)
        if numbers is None:
            out += "MISSING"
        else:
            quaternion, place = numbers
            out += "".join(f"{round(v * 1e4):+06d}" for v in quaternion)
            out += "".join(f"{round(v * 1e2):+07d}" for v in place) + f"{round(seen.error_mm * 1e4):+06d}"
        out += f"{status:08X}{max(frame, 0):08X}\n"
    return out + f"{system_status:04X}"


def binary(ports: Ports, scene: Scene, frame: int, options: int, system_status: int) -> bytes:
    """BX."""
    body = struct.pack("<B", len(ports.by_handle))
    for port in ports.by_handle.values():
        if not port.enabled:
            body += struct.pack("<BB", port.handle, _DISABLED)
            continue
        numbers, seen, status = _look(scene, port, frame, options)
        if numbers is None:
            body += struct.pack("<BB", port.handle, _MISSING)
        else:
            body += struct.pack("<BB8f", port.handle, _VALID, *numbers[0], *numbers[1], seen.error_mm)
        body += struct.pack("<II", status, max(frame, 0))
    return binary_reply(body + struct.pack("<H", system_status))
