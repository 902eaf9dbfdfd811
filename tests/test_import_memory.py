"""Cost of an import: a bag of a million messages is never held twice, and is read in the time that rosbags takes."""

import sqlite3
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore

from galen_hw.recording import read_recording

ROWS = 1_000_000
TABLE_MB = ROWS * 7 * 8 / 1e6
IMPORT = """
import sys
from pathlib import Path
import numpy, pyarrow.parquet, rosbags.rosbag2, rosbags.typesys
import galen_hw.formats, galen_hw.premises, galen_hw.recording.table, galen_hw.tools.import_table
from galen_hw.cli import main
bag, out = sys.argv[1:]
def held(what):  # not ru_maxrss: a child begins with its parent's
    return int(Path("/proc/self/status").read_text().partition(what + ":")[2].split()[0]) * 1024 / 1e6
before = held("VmRSS")
assert main(["import", bag, "-o", out, "--format", "parquet"]) == 0
print(held("VmHWM") - before)
"""
SPENT = """
import sys, time
from pathlib import Path
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
import galen_hw.formats, galen_hw.premises, galen_hw.recording.table, galen_hw.tools.import_table, pyarrow.parquet
from galen_hw.cli import main
bag, out = sys.argv[1:]
begun = time.process_time()
assert main(["import", bag, "-o", out, "--format", "parquet"]) == 0
ours = time.process_time() - begun
store = get_typestore(Stores.ROS2_HUMBLE)
begun = time.process_time()
with Reader(Path(bag)) as reader:
    read = sum(store.deserialize_cdr(raw, one.msgtype).wrench.force.x != 9.0 for one, _, raw in reader.messages())
print(read, ours, time.process_time() - begun)
"""


def bag(path: Path, rows: int) -> np.ndarray:
    """Write wrenches of a kilohertz: the first by rosbags, the rest into its database byte for byte alike; return (rows, 6)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    point = kinds["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](0, 0), "ft")
    first = kinds["geometry_msgs/msg/WrenchStamped"](header, kinds["geometry_msgs/msg/Wrench"](point, point))
    raw = bytearray(store.serialize_cdr(first, first.__msgtype__))
    with Bag2(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as out:
        out.write(out.add_connection("/ft", first.__msgtype__, typestore=store), 0, bytes(raw))
    values = np.random.default_rng(0).normal(size=(rows, 6))

    def messages():
        for i, row in enumerate(values.tolist()):
            ns = 1_700_000_000_000_000_000 + i * 1_000_000
            struct.pack_into("<iI", raw, 4, ns // 10**9, ns % 10**9)
            struct.pack_into("<6d", raw, len(raw) - 48, *row)
            yield ns, bytes(raw)

    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM messages")
        database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)", messages())
    database.close()
    return values


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_million_messages_take_less_than_twice_their_table(tmp_path: Path) -> None:
    """Resident memory at its height, over what the program and its libraries have before; every number comes through."""
    values = bag(tmp_path / "bag", ROWS)
    words = [str(tmp_path / name) for name in ("bag", "out")]
    done = subprocess.run([sys.executable, "-c", IMPORT, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = read_recording(tmp_path / "out")
    np.testing.assert_array_equal(found.wrench, values)
    np.testing.assert_allclose(found.columns["time"], np.arange(ROWS) * 1e-3, atol=1e-9)
    used = float(done.stdout.splitlines()[-1])
    assert used < 2.0 * TABLE_MB, f"{used:.0f} MB for a table of {TABLE_MB:.0f} MB"
    print(f"{used:.0f} MB for a table of {TABLE_MB:.0f} MB")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_import_takes_at_most_half_as_long_again_as_rosbags_alone(tmp_path: Path) -> None:
    """Processor time in one process, after the libraries are loaded: rosbags reads and deserialises, we write a table too."""
    rows = 200_000
    bag(tmp_path / "bag", rows)
    words = [str(tmp_path / name) for name in ("bag", "out")]
    done = subprocess.run([sys.executable, "-c", SPENT, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    read, ours, theirs = map(float, done.stdout.splitlines()[-1].split())
    assert read == rows
    assert ours <= 1.5 * theirs, f"{ours:.2f} s beside {theirs:.2f} s"
    print(f"{ours:.2f} s beside {theirs:.2f} s")
