"""Reads Parquet, once the file's parts agree on how long it is."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa


def parquet_table(file: Path) -> "pa.Table":
    """Read a Parquet file.

    Raises:
        OSError, pa.ArrowException, UnicodeDecodeError: it is damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    # Memory is reserved for as many rows as each group claims, whatever the file holds: a damaged byte asks for gigabytes.
    head = pq.read_metadata(file)
    rows = sum(head.row_group(k).num_rows for k in range(head.num_row_groups))
    if rows != head.num_rows:
        raise pa.ArrowInvalid(f"of {head.num_rows} rows its parts have {rows}")
    table = pq.read_table(file)
    # Names are decoded when they are asked for: one that is no UTF-8 is refused here.
    list(table.column_names)
    return table
