"""Whether a file or folder is a recording in galen-hw's own formats."""

from pathlib import Path

from galen_hw.formats.contents import head_of
from galen_hw.messages import TOPICS
from galen_hw.recording.from_mcap import TABLE_TOPIC
from galen_hw.recording.mcap_reader import ENCODINGS, MAGIC, held_in
from galen_hw.recording.recording import FIXED_COLUMNS, joint_column

TABLES = ("recording.csv", "recording.parquet", "recording.json")
BAGS = ("metadata.yaml", "*.db3", "*.db3.zstd", "*.mcap.zstd")


def is_own(path: Path) -> bool:
    """Return whether `read_recording` reads it: a table folder or one of its files, or an MCAP file of the recorder."""
    if path.is_dir():
        return not any(next(path.glob(pattern), None) for pattern in (*BAGS, "*.mcap")) or _has_table(path)
    if path.name in TABLES:
        return True
    head = head_of(path)
    if head.data.startswith(MAGIC):
        held = held_in(path)
        ours = [h.encoding for topic, h in held.items() if topic in TOPICS or topic == TABLE_TOPIC]
        return not held or any(encoding in ENCODINGS for encoding in ours)
    if path.suffix == ".csv" and (path.parent / "recording.json").is_file():
        cells = [cell.strip() for cell in (head.lines or [""])[0].split(",")]
        return any(cell in FIXED_COLUMNS - {"time", "segment"} or joint_column(cell) for cell in cells)
    return False


def expanded(path: Path) -> list[Path]:
    """Return the recordings of a folder of recordings (table folders, MCAP files of the recorder); else the path itself."""
    if not path.is_dir() or any((path / name).exists() for name in (*TABLES, "metadata.yaml")):
        return [path]
    inside = sorted(p for p in path.iterdir() if (p / "recording.json").exists() or (p.suffix == ".mcap" and is_own(p)))
    return inside or [path]


def _has_table(path: Path) -> bool:
    return any((path / name).is_file() for name in TABLES[:2])
