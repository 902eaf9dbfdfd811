"""Reads Parquet with memory for what a file holds, not for what it claims."""

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

    with pq.ParquetFile(file) as content:
        # Read at once, memory is reserved for as many rows as the head claims, and fewer in the file are no error (pyarrow 26).
        table = pa.Table.from_batches(content.iter_batches(), content.schema_arrow)
        claimed = content.metadata.num_rows
    if table.num_rows != claimed:
        raise pa.ArrowInvalid(f"of {claimed} rows it holds {table.num_rows}")
    # Names are decoded when they are asked for: one that is no UTF-8 is refused here.
    list(table.column_names)
    return table
