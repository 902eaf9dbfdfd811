"""Recordings of other programs: read by content, mapped by name, type and unit, joined on one clock.

`read` is what commands call: a recording of galen-hw's own is read as ever, anything else through the table `FORMATS`.
"""

from galen_hw.formats.imported import Imported, import_files, read

__all__ = ["Imported", "import_files", "read"]
