"""Parquet, of any column types that are numbers or times."""

from pathlib import Path
from typing import Final

from galen_hw.extras import need
from galen_hw.formats.contents import Contents, Head, unreadable
from galen_hw.formats.frames import stream_of_frame
from galen_hw.recording.parquet_file import parquet_table

MAGIC: Final = b"PAR1"


def sniff(head: Head) -> bool:
    """By its signature."""
    return head.data.startswith(MAGIC)


def read(path: Path) -> Contents:
    """One stream.

    Raises:
        UsageError: it cannot be read, or pyarrow or pandas is not installed.
    """
    need("import", str(path), "pyarrow", "pandas")
    import pyarrow as pa

    try:
        frame = parquet_table(path).to_pandas()
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise unreadable(path, error, "its index stands at the end: is the file whole?") from None
    contents = Contents()
    contents.streams.append(stream_of_frame("", frame, contents))
    return contents
