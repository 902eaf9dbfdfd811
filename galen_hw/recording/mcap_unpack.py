"""Chunks of an MCAP file, unpacked within bounds: a few kilobytes can claim, or become, many gigabytes."""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any, Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

MAX_RECORD_BYTES: Final = 256 * 2**20
"""Of one record or one chunk, unpacked: the writers in use make chunks of some megabytes."""
_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")


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
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum does not fit")
    return list(_broken_up(data))


def _broken_up(data: bytes) -> Iterator[Any]:
    """The records of an unpacked chunk; messages, of which there may be a million, without a stream for each."""
    place = 0
    while place + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size
        if place + length > len(data):
            raise ValueError("a record reaches beyond its chunk")
        if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, place)
            yield Message(
                channel_id=channel,
                log_time=log_time,
                data=data[place + _MESSAGE.size : place + length],
                publish_time=publish_time,
                sequence=sequence,
            )
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(ReadDataStream(BytesIO(data[place : place + length])))
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(ReadDataStream(BytesIO(data[place : place + length])))
        place += length


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
