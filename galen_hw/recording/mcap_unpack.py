"""Chunks of an MCAP file, unpacked within bounds: a few kilobytes can claim, or become, many gigabytes."""

from dataclasses import replace
from io import BytesIO
from typing import Any, Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk
from mcap.stream_reader import breakup_chunk

MAX_RECORD_BYTES: Final = 256 * 2**20
"""Of one record or one chunk, unpacked: the writers in use make chunks of some megabytes."""


def unpacked(body: bytes) -> list[Any]:
    """The records of a chunk, its checksum compared.

    Raises:
        ValueError: it is larger than `MAX_RECORD_BYTES`, damaged, or compressed in a way that is not known.
    """
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    if chunk.uncompressed_size > MAX_RECORD_BYTES:
        raise _too_large(f"{chunk.uncompressed_size} bytes")
    data = _decompressed(chunk.compression, chunk.data, chunk.uncompressed_size)
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"a chunk said to be of {chunk.uncompressed_size} bytes has others")
    return list(breakup_chunk(replace(chunk, data=data, compression=""), validate_crc=True))


def _decompressed(compression: str, data: bytes, size: int) -> bytes:
    """At most one byte more than `size`, whatever the compressed data say of themselves."""
    if compression == "zstd":
        # zstandard.decompress() would take the size in the frame's own head for true, and reserve it.
        limited = zstandard.ZstdDecompressor(max_window_size=MAX_RECORD_BYTES)
        with limited.stream_reader(data, read_across_frames=True) as reader:
            return bytes(reader.read(size + 1))
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    if compression:
        raise ValueError(f"compressed as {compression!r}, which is not known")
    return data


def _too_large(size: str) -> ValueError:
    return ValueError(f"it unpacks to {size}; at most {MAX_RECORD_BYTES} are read")
