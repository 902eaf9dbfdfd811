"""Tool definitions (.rom) of the virtual marker bodies, and what a tracker accepts as one.

Layout: 752 bytes, little endian, as the Johns Hopkins group that drives these trackers has worked out
(sawNDITracker, `share/roms` and its tool converter). NDI's own document of the format is not public.
"""

import struct
from typing import Final

SIZE: Final = 752
SIGNATURE: Final = b"NDI"
_CHECKSUM: Final = 4
_FIRST_SUMMED: Final = 6
_COUNT: Final = 28
_FEWEST, _MOST = 3, 20

Spheres = tuple[tuple[float, float, float], ...]

TOOL_SPHERES_MM: Final[Spheres] = ((0.0, 0.0, 0.0), (0.0, 29.0, 41.0), (0.0, 0.0, 88.0), (0.0, -44.0, 40.0))
REFERENCE_SPHERES_MM: Final[Spheres] = ((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (0.0, 20.0, 100.0), (0.0, -25.0, 135.0))
"""Four spheres each, all distances between them different: a body is told by its geometry."""


def make_definition(spheres_mm: Spheres, part_number: str) -> bytes:
    """The definition of a passive body with these spheres, as the maker's software would write it."""
    count = len(spheres_mm)
    data = bytearray(SIZE)
    data[:3] = SIGNATURE
    data[8], data[12] = 1, 2  # constant; sub type "undefined"
    data[24], data[_COUNT], data[32] = 90, count, _FEWEST  # largest marker angle, degrees; fewest markers seen
    struct.pack_into("<f", data, 36, 2.0)  # largest 3D error, mm
    for i, sphere in enumerate(spheres_mm):
        struct.pack_into("<3f", data, 72 + 12 * i, *sphere)
        struct.pack_into("<3f", data, 312 + 12 * i, 1.0, 0.0, 0.0)  # normals
        data[552 + i] = i  # firing order
        data[613 + i] = data[633 + i] = 1  # face and group
    data[572:577] = bytes((31, 31, 31, 31, 9))  # no diodes
    data[580:592] = b"VIRTUAL".ljust(12, b"\0")
    data[592:612] = part_number.encode("ascii").ljust(20, b"\0")
    data[612], data[653], data[655] = 9, 128, 41  # 128: unique geometry; 41: passive spheres
    struct.pack_into("<H", data, _CHECKSUM, checksum(data))
    return bytes(data)


def checksum(data: bytes | bytearray) -> int:
    """Sum of all bytes after the checksum's own place, 16 bits."""
    return sum(data[_FIRST_SUMMED:]) & 0xFFFF


def is_definition(data: bytes | bytearray) -> bool:
    """Return whether a tracker can make a tool of these bytes: signature, checksum, and a possible number of markers."""
    if len(data) < SIZE or data[:3] != SIGNATURE:
        return False
    return struct.unpack_from("<H", data, _CHECKSUM)[0] == checksum(data) and _FEWEST <= data[_COUNT] <= _MOST


DEFINITIONS: Final = {
    "tool.rom": make_definition(TOOL_SPHERES_MM, "VIRTUAL-TOOL"),
    "reference.rom": make_definition(REFERENCE_SPHERES_MM, "VIRTUAL-REFERENCE"),
}
"""What comes in the box, by file name."""
