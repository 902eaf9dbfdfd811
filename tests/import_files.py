"""One small recording, written by the real writers of every format that is imported."""

import csv
import struct
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final

import can
import h5py
import numpy as np
import pandas as pd
import scipy.io
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer as McapWriter
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from galen_hw.drivers.ati_netcanoem import codec as ati
from galen_hw.drivers.iit_strain import codec as strain
from galen_hw.drivers.robotous_rft import codec as rft
from galen_hw.kinematics import UrdfRobot
from galen_hw.recording.recording import SENSOR_ORIENTATION, WRENCH
from galen_hw.spatial import Array
from tests.urdf_parts import joint, link, robot

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it sets an option of pandas that is the default by now
    from matio import save_to_mat

N, STEP_S = 100, 0.12
MASS, COM = 0.5, np.array([0.01, 0.0, 0.06])
EPOCH_NS: Final = 1_700_000_000_000_000_000
NS: Final = EPOCH_NS + np.arange(N) * round(STEP_S * 1e9)
TOPICS: Final = {"w": "/ft/raw", "p": "/flange/pose", "j": "/joint_states"}


@cache
def table() -> dict[str, Array]:
    """A tool of 0.5 kg that is turned about, as our own columns: nobody tells the simulation of it."""
    rng, t = np.random.default_rng(4), np.arange(N) * STEP_S
    turn = Rotation.from_euler("xyz", np.c_[0.9 * np.sin(0.7 * t), 0.8 * np.sin(1.1 * t + 1), 0.5 * np.sin(0.5 * t)])
    force = turn.inv().apply([0.0, 0.0, -9.80665 * MASS])
    wrench = np.c_[force, np.cross(COM, force)] + rng.normal(size=(N, 6)) * ([0.05] * 3 + [0.0025] * 3)
    names = ("time", *WRENCH, *SENSOR_ORIENTATION)
    return dict(zip(names, np.c_[t, wrench, turn.as_quat()].T, strict=True))


def wrench() -> Array:
    return np.stack([table()[name] for name in WRENCH], axis=1)


def turns() -> Array:
    return np.stack([table()[name] for name in SENSOR_ORIENTATION], axis=1)


HEADER: Final = ("time", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "qx", "qy", "qz", "qw")


def frame() -> pd.DataFrame:
    return pd.DataFrame(dict(zip(HEADER, table().values(), strict=True)))


# ---------------------------------------------------------------- tables


def plain_csv(folder: Path) -> Path:
    frame().to_csv(folder / "run.csv", index=False)
    return folder / "run.csv"


def german_csv(folder: Path) -> Path:
    """Semicolons, decimal commas, a preamble, units in the names, a byte that is not UTF-8."""
    path = folder / "messung.txt"
    found = frame()
    found["time"] *= 1000.0
    found[["Tx", "Ty", "Tz"]] *= 1000.0
    units = ["ms", "N", "N", "N", "N mm", "N mm", "N mm"]
    found.columns = [f"{n} [{u}]" for n, u in zip(HEADER, units, strict=False)] + list(HEADER[7:])
    with path.open("w", encoding="latin-1", newline="") as out:
        out.write("Messung für Werkzeug 5\r\n")
        found.to_csv(out, index=False, sep=";", decimal=",")
    return path


def tab_csv(folder: Path) -> Path:
    """Tabs, and a line of units below the names."""
    path = folder / "run.tsv"
    units = ["s", "N", "N", "N", "Nm", "Nm", "Nm", "-", "-", "-", "-"]
    rows = ["\t".join(HEADER), "\t".join(units), *("\t".join(map(repr, row)) for row in frame().values.tolist())]
    path.write_text("\n".join(rows) + "\n")
    return path


def parquet(folder: Path) -> Path:
    found = frame()
    found["time"] = pd.to_datetime(NS)
    found.to_parquet(folder / "run.parquet")
    return folder / "run.parquet"


def matlab5(folder: Path) -> Path:
    path = folder / "struct.mat"
    inner = {"time": table()["time"], "ft": wrench(), "quat": turns()}
    scipy.io.savemat(path, {"data": inner, "comment": "run 5"})
    return path


def matlab4(folder: Path) -> Path:
    path = folder / "four.mat"
    scipy.io.savemat(path, {"time": table()["time"], "wrench": wrench(), "quat": turns()}, format="4")
    return path


def matlab_table(folder: Path) -> Path:
    """A MATLAB table."""
    path = folder / "table.mat"
    save_to_mat(str(path), {"T": frame()})
    return path


def matlab73(folder: Path) -> Path:
    """Version 7.3: a timetable."""
    path = folder / "new.mat"
    found = frame().drop(columns="time").set_index(pd.to_datetime(NS).rename("Time"))
    save_to_mat(str(path), {"TT": found}, version="v7.3")
    return path


def hdf5(folder: Path) -> Path:
    """Groups with clocks of their own; units as attributes."""
    path = folder / "run.h5"
    with h5py.File(path, "w") as file:
        one, other = file.create_group("sensor"), file.create_group("robot")
        one["time"] = other["time"] = table()["time"]
        one.create_dataset("wrench", data=wrench())
        other["orientation"] = turns()
    return path


# ---------------------------------------------------------------- ROS


def ros_messages(store: Any, *, ros1: bool = False) -> list[tuple[str, int, Any]]:
    """(topic, log time, message), the log 2 ms late."""
    kinds = store.types
    extra = (0,) if ros1 else ()

    def header(i: int, frame: str) -> Any:
        stamp = kinds["builtin_interfaces/msg/Time"](int(NS[i]) // 10**9, int(NS[i]) % 10**9)
        return kinds["std_msgs/msg/Header"](*extra, stamp, frame)

    vector, out = kinds["geometry_msgs/msg/Vector3"], []
    for i, (w, q) in enumerate(zip(wrench().tolist(), turns().tolist(), strict=True)):
        inner = kinds["geometry_msgs/msg/Wrench"](vector(*w[:3]), vector(*w[3:]))
        out.append((TOPICS["w"], int(NS[i]), kinds["geometry_msgs/msg/WrenchStamped"](header(i, "ft"), inner)))
        point, turn = kinds["geometry_msgs/msg/Point"](0.1, 0.2, 0.3), kinds["geometry_msgs/msg/Quaternion"](*q)
        pose = kinds["geometry_msgs/msg/Pose"](point, turn)
        out.append((TOPICS["p"], int(NS[i]), kinds["geometry_msgs/msg/PoseStamped"](header(i, "base"), pose)))
    return [(topic, ns + 2_000_000, message) for topic, ns, message in out]


def rosbag2(folder: Path, plugin: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    path, store = folder / "bag", get_typestore(Stores.ROS2_HUMBLE)
    with Bag2(path, version=9, storage_plugin=plugin) as bag:
        connections: dict[str, Any] = {}
        for topic, ns, message in ros_messages(store):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], ns, store.serialize_cdr(message, kind))
    return path


def rosbag2_mcap(folder: Path) -> Path:
    return rosbag2(folder, StoragePlugin.MCAP)


def rosbag1(folder: Path) -> Path:
    path, store = folder / "run.bag", get_typestore(Stores.ROS1_NOETIC)
    bag = Bag1(path)
    bag.set_compression(Bag1.CompressionFormat.LZ4)
    with bag:
        connections: dict[str, Any] = {}
        for topic, ns, message in ros_messages(store, ros1=True):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], ns, store.serialize_ros1(message, kind))
    return path


WRENCH_DEFINITION: Final = """std_msgs/Header header
geometry_msgs/Wrench wrench
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
TURN_DEFINITION: Final = """builtin_interfaces/Time stamp
float64[4] quat
string note
"""


def mcap_ros2(folder: Path) -> Path:
    """By mcap-ros2-support, which foxglove_bridge's users have: no metadata.yaml, and a message of the user's own."""
    path = folder / "run.mcap"
    with path.open("wb") as out:
        writer = Ros2Writer(out)
        kinds = {
            "w": writer.register_msgdef("geometry_msgs/msg/WrenchStamped", WRENCH_DEFINITION),
            "q": writer.register_msgdef(
                "my_robot/msg/Turn", "builtin_interfaces/Time stamp\nfloat64 qx\nfloat64 qy\nfloat64 qz\nfloat64 qw"
            ),
        }
        for i, (w, q) in enumerate(zip(wrench().tolist(), turns().tolist(), strict=True)):
            stamp = {"sec": int(NS[i]) // 10**9, "nanosec": int(NS[i]) % 10**9}
            parts = [dict(zip("xyz", part, strict=True)) for part in (w[:3], w[3:])]
            message = {
                "header": {"stamp": stamp, "frame_id": "ft"},
                "wrench": dict(zip(("force", "torque"), parts, strict=True)),
            }
            writer.write_message("/ft/raw", kinds["w"], message, log_time=int(NS[i]))
            turn = {"stamp": stamp} | dict(zip(("qx", "qy", "qz", "qw"), q, strict=True))
            writer.write_message("/flange", kinds["q"], turn, log_time=int(NS[i]))
        writer.finish()
    return path


def mcap_json(folder: Path) -> Path:
    """JSON, shuffled: the format promises no order."""
    import json

    path = folder / "run.mcap"
    with path.open("wb") as out:
        writer = McapWriter(out)
        writer.start()
        schema = writer.register_schema("Sample", "jsonschema", b"{}")
        channel = writer.register_channel("/sample", "json", schema)
        for i in np.random.default_rng(1).permutation(N).tolist():
            row = {"force": dict(zip("xyz", wrench()[i, :3].tolist(), strict=True))}
            row["torque"] = dict(zip("xyz", wrench()[i, 3:].tolist(), strict=True))
            row["orientation"] = dict(zip("xyzw", turns()[i].tolist(), strict=True))
            writer.add_message(channel, int(NS[i]), json.dumps(row).encode(), int(NS[i]))
        writer.finish()
    return path


def _message_class() -> Any:
    """A Protobuf message `lab.Sample` with six forces and four quaternion parts."""
    file = descriptor_pb2.FileDescriptorProto(name="sample.proto", package="lab", syntax="proto3")
    message = file.message_type.add(name="Sample")
    for number, name in enumerate(HEADER[1:], 1):
        message.field.add(name=name.lower(), number=number, type=1, label=1)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("lab.Sample"))


def mcap_protobuf(folder: Path) -> Path:
    path, kind = folder / "run.mcap", _message_class()
    with path.open("wb") as out, ProtobufWriter(out) as writer:
        for i, row in enumerate(np.c_[wrench(), turns()].tolist()):
            message = kind(**{name.lower(): x for name, x in zip(HEADER[1:], row, strict=True)})
            writer.write_message("/sample", message, log_time=int(NS[i]), publish_time=int(NS[i]))
    return path


# ---------------------------------------------------------------- CAN

MATRIX: Final = np.diag([4e-3] * 3 + [2e-4] * 3) + 1e-5 * np.random.default_rng(2).normal(size=(6, 6))
"""Counts to N and N m."""


def ati_frames(*, start: bool = True, asked: bool = True) -> list[can.Message]:
    """What candump sees: the start of the daemon, then requests and replies."""
    base, out = 0x20 << 4, []

    def add(opcode: int, data: bytes, ns: int) -> None:
        out.append(can.Message(timestamp=ns * 1e-9, arbitration_id=base | opcode, data=data, is_extended_id=False))

    if start:
        before = EPOCH_NS - 10**9
        add(0xF, bytes([3, 8, 0, 1]), before)
        add(0x5, b"FT12345\0", before + 10**6)
        for axis in range(6):
            row = struct.pack(">6f", *(1e6 * MATRIX[axis]))
            add(0x2, bytes([axis]), before + (axis + 2) * 10**6)
            for part in range(3):
                add(0x2 + part, row[8 * part : 8 * part + 8], before + (axis + 2) * 10**6 + (part + 1) * 10**5)
        add(0x7, struct.pack(">II", 10**6, 10**6), before + 10**8)
        add(0x8, bytes([2, 3]), before + 2 * 10**8)
    for i, counts in enumerate(np.round(wrench() @ np.linalg.inv(MATRIX).T).astype(int)):
        first, second = ati.encode_sample(0, tuple(counts.tolist()))
        if asked:
            add(0x0, b"", int(NS[i]) - 400_000)
        add(0x0, first, int(NS[i]) - 200_000)
        add(0x1, second, int(NS[i]))
    return out


def rft_frames() -> list[can.Message]:
    """A Robotous RFT60 that streams, after it has said its model."""
    out = []

    def add(response: bytes, ns: int) -> None:
        for part, number in enumerate((0x01, 0x02)):
            data, stamp = response[8 * part : 8 * part + 8], (ns + part * 200_000) * 1e-9
            out.append(can.Message(timestamp=stamp, arbitration_id=number, data=data, is_extended_id=False))

    add(bytes([rft.Command.READ_MODEL]) + b"RFT60-HA01".ljust(15, b"\0"), EPOCH_NS - 10**9)
    for i, row in enumerate(wrench()):
        axes = np.round(row * ([50.0] * 3 + [2000.0] * 3)).astype(int)
        add(b"".join(rft.encode_data(tuple(axes.tolist()), 0)), int(NS[i]) - 200_000)
    return out


def strain_frames(*, start: bool = True) -> list[can.Message]:
    """An IIT sensor at address 3 that streams, after it has said its full scales and its number."""
    out, scales = [], np.array([300, 300, 400, 10, 10, 8])

    def add(identifier: int, data: bytes, ns: int) -> None:
        out.append(can.Message(timestamp=ns * 1e-9, arbitration_id=identifier, data=data, is_extended_id=False))

    if start:
        before = EPOCH_NS - 10**9
        add(strain.answer_id(3), bytes([strain.Command.GET_SERIAL_NUMBER]) + b"SN042\0\0", before)
        for channel, scale in enumerate(scales.tolist()):
            data = bytes([strain.Command.GET_FULL_SCALE, channel, *scale.to_bytes(2, "big")])
            add(strain.answer_id(3), data, before + (channel + 1) * 10**6)
    for i, row in enumerate(wrench()):
        counts = np.round(row * 0x8000 / scales).astype(int).tolist()
        for kind, part, late_ns in ((strain.Stream.FORCE, counts[:3], 200_000), (strain.Stream.TORQUE, counts[3:], 0)):
            add(strain.stream_id(3, kind), strain.encode_vector(tuple(part)), int(NS[i]) - late_ns)
    return out


def can_log(folder: Path, kind: str = "log", frames: list[can.Message] | None = None) -> Path:
    """The log, how the sensor stood in a CSV beside it, and the map that names it."""
    path = folder / f"sensor.{kind}"
    with can.Logger(str(path)) as log:
        for message in ati_frames() if frames is None else frames:
            log(message)
    _beside(path)
    return path


def _beside(path: Path, also: str = "poses.csv") -> None:
    stamps = NS * 1e-9
    rows = np.c_[stamps, turns()]
    with (path.parent / also).open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("timestamp", "qx", "qy", "qz", "qw"))
        writer.writerows(rows.tolist())
    path.with_name(path.name + ".map.toml").write_text(f'also = ["{also}"]\n')


def candump_terminal(folder: Path) -> Path:
    """`candump -ta can0` as it stands on the screen."""
    path = folder / "screen.txt"
    lines = [
        f" ({m.timestamp:.6f})  can0  {m.arbitration_id:03X}   [{len(m.data)}]  {m.data.hex(' ').upper()}"
        for m in ati_frames()
    ]
    path.write_text("\n".join(lines) + "\n")
    _beside(path)
    return path


def robotous_log(folder: Path) -> Path:
    return can_log(folder, "log", rft_frames())


def strain_log(folder: Path) -> Path:
    return can_log(folder, "log", strain_frames())


# ---------------------------------------------------------------- robots and trackers


def ur_csv(folder: Path, separator: str = " ") -> Path:
    """UR's own client writes blanks, ur_rtde commas."""
    path = folder / "robot_data.csv"
    rotation = Rotation.from_quat(turns())
    poses = np.c_[np.tile([0.1, 0.2, 0.3], (N, 1)), rotation.as_rotvec()]
    in_base = np.c_[rotation.apply(wrench()[:, :3]), rotation.apply(wrench()[:, 3:])]
    names = ["timestamp", *(f"{n}_{i}" for n in ("actual_TCP_pose", "actual_TCP_force") for i in range(6))]
    rows = np.c_[1000.0 + table()["time"], poses, in_base].tolist()
    path.write_text("\n".join([separator.join(names), *(separator.join(map(repr, row)) for row in rows)]) + "\n")
    return path


def ur_csv_commas(folder: Path) -> Path:
    return ur_csv(folder, ",")


JOINTS: Final = 7
AXES: Final = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 -1 0", "0 0 1")


TRACKED: Final = 3


@cache
def arm(joints: int = JOINTS) -> str:
    """A URDF."""
    parts = [link("base", 5.0)]
    for i, axis in enumerate(AXES[:joints], 1):
        parent = "base" if i == 1 else f"link{i - 1}"
        parts += [link(f"link{i}", 3.4 - 0.3 * i), joint(f"arm_joint{i}", parent, f"link{i}", axis, at="0.03 0 0.2")]
    parts += [link("flange"), joint("flange_mount", f"link{joints}", "flange", kind="fixed", at="0 0 0.1")]
    return robot(*parts)


@cache
def motion(rows: int = 100, step_s: float = 0.12) -> tuple[Array, Array, Array, Array]:
    """Time, and positions, velocities and accelerations of the seven joints."""
    t = np.arange(rows) * step_s
    w = np.array([0.9, 0.7, 1.1, 0.8, 1.3, 1.0, 1.2]) * 1.1
    phase = np.arange(JOINTS) * 0.7
    angle = t[:, None] * w + phase
    return t, 0.8 * np.sin(angle), 0.8 * w * np.cos(angle), -0.8 * w**2 * np.sin(angle)


def libfranka(folder: Path) -> Path:
    """`franka::logToCSV`, the URDF beside it; the arm bears 0.5 kg that nobody told of."""
    (folder / "arm.urdf").write_text(arm())
    t, q, dq, ddq = motion()
    whole = UrdfRobot(arm(), sensor_link="flange")
    body = np.array([0.5, 0, 0, 0.5 * 0.06, 1e-3, 0, 1e-3, 0, 0, 1e-3])
    loaded = whole.with_load(body)
    assert loaded is not None
    rng = np.random.default_rng(5)
    tau = loaded.inverse_dynamics(q, dq, ddq) + 0.02 * rng.normal(size=q.shape)
    names = ["duration", "success rate"]
    blocks = {"q": q, "q_d": q, "dq": dq, "dq_d": dq, "tau_J": tau, "tau_ext_hat_filtered": 0 * q}
    heads = [", ".join(f"{n}[{i}]" for i in range(JOINTS)) for n in blocks]
    lines = [
        ", ".join(names)
        + ", "
        + ",".join(heads)
        + ",sent commands,"
        + ", ".join(f"tau_J_d[{i}]" for i in range(JOINTS))
    ]
    for row in range(len(t)):
        cells = [str(round(1000 * t[row])), "1", *(repr(float(x)) for block in blocks.values() for x in block[row])]
        lines.append(",".join(cells) + ",," + ",".join("0" for _ in range(JOINTS)))
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


OFFSET: Final = 0.03
"""rad, the hidden zero error of joint 2."""


def _tracked(rows: int = 60) -> tuple[Array, Array, Array]:
    """Time, joints as reported, and three points of the flange in the tracker's frame, m."""
    t, q = (part[:rows] for part in motion(rows, 0.2)[:2])
    q = q[:, :TRACKED]
    true = q.copy()
    true[:, 1] += OFFSET
    T = UrdfRobot(arm(TRACKED), sensor_link="flange").sensor_pose(true)
    tracker = Rotation.from_euler("xyz", [0.3, -1.0, 2.0])
    points = np.array([[0.05, 0, 0], [0, 0.06, 0.02], [-0.04, 0, 0.05]])
    rng = np.random.default_rng(6)
    seen = [
        tracker.apply(T[:, :3, 3] + T[:, :3, :3] @ p + [0.2, -0.1, 1.5]) + 1e-4 * rng.normal(size=(rows, 3))
        for p in points
    ]
    return t, q, np.stack(seen, axis=1)


def _joints_csv(folder: Path, t: Array, q: Array) -> None:
    (folder / "arm.urdf").write_text(arm(TRACKED))
    rows = np.c_[t, q].tolist()
    head = ["time", *(f"q{i + 1}" for i in range(TRACKED))]
    (folder / "joints.csv").write_text("\n".join([",".join(head), *(",".join(map(repr, row)) for row in rows)]) + "\n")


def ndi_toolbox(folder: Path) -> Path:
    t, q, points = _tracked()
    _joints_csv(folder, t, q)
    group = "Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"
    lines = ["Tools," + ",".join(f"Port {k + 1},{group}" for k in range(3))]
    for i in range(len(t)):
        tools = []
        for k in range(3):
            lost = k == 1 and i % 40 == 39
            place = ",,,,,,," if lost else "1,0,0,0," + ",".join(f"{1000 * x:.3f}" for x in points[i, k]) + ",0.1"
            tools.append(f"{k + 1},{12000 + 12 * i},0,{'Missing' if lost else 'OK'},{place}")
        lines.append("3," + ",".join(tools))
    path = folder / "track.csv"
    path.write_text("\n".join(lines) + "\n")
    columns = '"time" = { column = "Frame", scale = 0.016666666666666666 }\n'
    path.with_name(path.name + ".map.toml").write_text(
        f'also = ["joints.csv"]\n[offset_s]\n"track.csv" = -200.0\n[recording]\npredict = "targets"\n[columns]\n{columns}'
    )
    return path


def first_principles(folder: Path) -> Path:
    t, q, points = _tracked()
    _joints_csv(folder, t, q)
    names = [f"Marker_{k + 1} {a}" for k in range(3) for a in "xyz"]
    lines = [f"Number of frames:\t{len(t)}", "Frequency:\t5", "Units:\tmm", "", "\t".join(["Frame", *names])]
    for i in range(len(t)):
        cells = ["" if (i % 40 == 39 and k // 3 == 1) else f"{1000 * x:.4f}" for k, x in enumerate(points[i].ravel())]
        lines.append("\t".join([str(i + 1), *cells]))
    path = folder / "run_3d.tsv"
    path.write_text("\n".join(lines) + "\n")
    path.with_name(path.name + ".map.toml").write_text('also = ["joints.csv"]\n[recording]\npredict = "targets"\n')
    return path


Make = Callable[[Path], Path]
WRENCHES: Final[dict[str, Make]] = {
    "ROS 2 bag, sqlite3": rosbag2,
    "ROS 2 bag, MCAP": rosbag2_mcap,
    "ROS 1 bag": rosbag1,
    "MCAP, ROS 2 (CDR), own messages": mcap_ros2,
    "MCAP, JSON": mcap_json,
    "MCAP, Protobuf": mcap_protobuf,
    "candump -L": can_log,
    "candump -ta": candump_terminal,
    "CAN log, .asc": lambda folder: can_log(folder, "asc"),
    "CAN log, .blf": lambda folder: can_log(folder, "blf"),
    "CAN log, .trc": lambda folder: can_log(folder, "trc"),
    "CAN log, .csv": lambda folder: can_log(folder, "csv"),
    "CAN log, .mf4": lambda folder: can_log(folder, "mf4"),
    "candump -L, Robotous": robotous_log,
    "candump -L, IIT": strain_log,
    "MATLAB 4": matlab4,
    "MATLAB 5 to 7, struct": matlab5,
    "MATLAB 5 to 7, table": matlab_table,
    "MATLAB 7.3, timetable": matlab73,
    "HDF5": hdf5,
    "Parquet": parquet,
    "CSV": plain_csv,
    "CSV, semicolons and decimal commas": german_csv,
    "CSV, tabs and a line of units": tab_csv,
    "UR RTDE, UR's client": ur_csv,
    "UR RTDE, ur_rtde": ur_csv_commas,
}
"""Formats that hold the wrench of `table()` and how the sensor stood."""
ARMS: Final[dict[str, Make]] = {
    "libfranka log": libfranka,
    "NDI Track or ToolBox CSV": ndi_toolbox,
    "NDI First Principles": first_principles,
}
