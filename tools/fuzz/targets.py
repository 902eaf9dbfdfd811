"""What is fuzzed: a function of bytes for each parser, and inputs to begin from. Anything but the errors below is a find."""

import io
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from galen_hw.config.load import examine
from galen_hw.config.problems import Places
from galen_hw.config.tool_file import parse_tool
from galen_hw.daemon.keep import Keeper
from galen_hw.daemon.links import Beat, not_older
from galen_hw.daemon.tables import TABLES
from galen_hw.decoding import (
    LARGEST_REQUEST,
    Reader,
    UnreadableError,
    decode_batch,
    decode_message,
    decode_reply,
    decode_request,
    id_of,
)
from galen_hw.documents import DocumentError, load_toml, sealed
from galen_hw.drivers.can_transport import COUNTERS
from galen_hw.drivers.slcan_wire import parse_line
from galen_hw.drivers.socketcand_wire import SocketcandWire
from galen_hw.errors import GalenError
from galen_hw.messages import (
    TOPICS,
    CommandError,
    CompensationState,
    JointsState,
    Reply,
    Request,
    Status,
    Vector3,
    WrenchRaw,
    encode,
    encode_batch,
)
from galen_hw.recording import read_recording
from galen_hw.recording.session import Session
from galen_hw.services.deflection.store import parse_deflection
from galen_hw.tools.fuzz import devices

OWN_ERRORS: Final = (GalenError, DocumentError)
CONFIG: Final = Path(__file__).parents[2] / "config"


@dataclass(frozen=True, slots=True)
class Target:
    """A parser.

    Args:
        make: prepares it, and gives the function of one input; that may raise `OWN_ERRORS` and nothing else.
        seeds: inputs that are what it takes.
    """

    make: Callable[[], Callable[[bytes], None]]
    seeds: Sequence[bytes]


def own_errors_only(function: Callable[[bytes], object]) -> Callable[[bytes], None]:
    """The function, whose typed errors are an answer."""

    def call(data: bytes) -> None:
        try:
            function(data)
        except OWN_ERRORS:
            return

    return call


def _command(data: bytes) -> None:
    request = decode_request(data)
    if not isinstance(request, CommandError) and len(data) > LARGEST_REQUEST:
        raise AssertionError("a request above the bound")
    encode(request)
    id_of(data)


def _control(data: bytes) -> None:
    kind, frame = data[:1], data[1:]
    encode(decode_reply(frame) if kind < b"\x80" else Reader(Beat)(frame))


def _batch(data: bytes) -> None:
    for topic, payload in decode_batch(data):
        decode_message(topic, payload)


def _bus(data: bytes) -> None:
    names = sorted(TOPICS)
    topic, payload = names[(data[0] if data else 0) % len(names)].encode(), data[1:]
    passed = not_older(topic, payload, 1 << 60, 1)
    try:
        message = decode_message(topic, payload)[1]
    except UnreadableError:
        return
    encode(message)
    if passed is not None and message.valid and decode_message(topic, passed)[1].valid:
        raise AssertionError("an old message is vouched for")


def _slcan(data: bytes) -> None:
    for line in data.split(b"\r"):
        try:
            frame = parse_line(line)
        except ValueError:
            continue  # counted by its only caller
        if frame is not None and (frame.arbitration_id > 0x7FF or len(frame.data) > 8):
            raise AssertionError(frame)


def _socketcand() -> Callable[[bytes], None]:
    wire = SocketcandWire.__new__(SocketcandWire)  # the parser alone, without a server
    wire.counters, wire._rest = dict.fromkeys(COUNTERS, 0), b""  # noqa: SLF001

    def call(data: bytes) -> None:
        for frame in wire.parse(data):
            if frame.arbitration_id > 0x7FF or len(frame.data) > 8:
                raise AssertionError(frame)

    return call


def _settings(data: bytes) -> None:
    text = data.decode(errors="replace")
    examine(load_toml(text), Path("galen.toml"), Places("galen.toml", text), TABLES)


def _kept() -> Callable[[bytes], None]:
    keeper = Keeper(_folder())
    path = _folder() / "fuzz.json"

    def call(data: bytes) -> None:
        path.write_bytes(data)
        found = keeper.read("fuzz")
        if found is not None:
            json.dumps(found)

    return call


def _recording(name: str) -> Callable[[], Callable[[bytes], None]]:
    """Reads a file of that name; beside a table lies its recording.json."""

    def make() -> Callable[[bytes], None]:
        folder = _folder()
        if not name.endswith(".mcap"):
            (folder / "recording.json").write_text(INFO, encoding="utf-8")
        if name == "recording.json":
            (folder / "recording.csv").write_bytes(CSV)

        def call(data: bytes) -> None:
            (folder / name).write_bytes(data)
            read_recording(folder / name)

        return own_errors_only(call)

    return make


def _folder() -> Path:
    """In memory where the machine has that."""
    shared = "/dev/shm" if os.path.isdir("/dev/shm") else None  # noqa: PTH112, S108
    folder = Path(shared or tempfile.gettempdir()) / f"galen-hw-fuzz-{os.getpid()}"
    folder.mkdir(exist_ok=True)
    return folder


def _mcap() -> bytes:
    memory = io.BytesIO()
    session = Session(memory, robot="galen", config="[robot]\n")
    state = CompensationState(timestamp=1.0, t_ns=0, seq=0, valid=True, tool="retractor")
    session.add("compensation/state", state, 10**18)
    for n in range(5):
        session.add("joints/state", _joints(n), 10**18 + n)
        session.add("wrench/raw", _wrench(n), 10**18 + n)
    session.finish()
    return memory.getvalue()


def _joints(n: int) -> JointsState:
    angles = {"roll": 0.1 * n, "tilt": 0.0}
    return JointsState(timestamp=1.0, t_ns=n, seq=n, valid=True, position=angles, velocity=angles, effort=angles)


def _wrench(n: int) -> WrenchRaw:
    vector = Vector3(1.0, 2.0, float(n))
    return WrenchRaw(timestamp=1.0, t_ns=n, seq=n, valid=True, force=vector, torque=vector, serial_number="FT1")


def _parquet() -> bytes:
    import pyarrow as pa
    from pyarrow import parquet

    memory = io.BytesIO()
    parquet.write_table(pa.table({"time": [0.0, 1.0], "force.x": [1.0, 2.0]}), memory)
    return memory.getvalue()


INFO: Final = '{"schema": 1, "robot": null}'
CSV: Final = b"time,force.x,force.y,force.z,torque.x,torque.y,torque.z\n0,1,2,3,4,5,6\n0.001,1,2,3,4,5,6\n"
_REQUEST: Final = encode(Request(id="1", target="motors", name="move_jp", args={"position": {"roll": 0.1}}))
_TOOLS: Final = tuple(p.read_bytes() for p in sorted((CONFIG / "tools").glob("*.json")))
_KEPT: Final = json.dumps(sealed({"version": 1, "identity": "x", "enabled": True})).encode()

TARGETS: Final[dict[str, Target]] = {
    "socket: command": Target(lambda: own_errors_only(_command), (_REQUEST,)),
    "socket: control": Target(
        lambda: own_errors_only(_control), (b"\0" + encode(Reply(id="1")), b"\xff" + encode(Beat(progress=3)))
    ),
    "socket: bus and inward": Target(
        lambda: own_errors_only(_bus),
        (
            bytes([sorted(TOPICS).index("wrench/raw")]) + encode(_wrench(1)),
            bytes([sorted(TOPICS).index("joints/state")]) + encode(_joints(1)),
            bytes([sorted(TOPICS).index("status")])
            + encode(Status(timestamp=0.0, t_ns=1, seq=1, valid=True, state="ready")),
        ),
    ),
    "socket: batches": Target(
        lambda: own_errors_only(_batch), (encode_batch([(b"wrench/raw", encode(_wrench(1))), (b"status", b"")]),)
    ),
    "wire: slcan": Target(lambda: own_errors_only(_slcan), (b"t2003010203\rz\rV1013\rF00\r",)),
    "wire: socketcand": Target(_socketcand, (b"< hi >< ok >< frame 200 1.5 0A0B >< error 4 >",)),
    "wire: ATI": Target(devices.ati, (bytes([8, 2, 0, *range(8)]), bytes([6, 2, 1, *range(6)]))),
    "wire: Robotous": Target(devices.robotous, (bytes([8, 0, 1, 0x0B, *range(7)]),)),
    "wire: IIT": Target(devices.iit, (bytes([6, 3, 0x1A, *range(6)]), bytes([4, 2, 0x10, 0x18, 0, 5, 220]))),
    "wire: Galil": Target(devices.galil, (b"\x05QR\r\n:?12.5\r\n:",)),
    "wire: NDI": Target(devices.ndi, (b"\x20OKAYA896\r", b"\x10RESETBE6F\r")),
    "file: tool": Target(lambda: own_errors_only(lambda d: parse_tool(d.decode(errors="replace"), "tool")), _TOOLS),
    "file: deflection model": Target(
        lambda: own_errors_only(lambda d: parse_deflection(d.decode(errors="replace"))),
        (b'{"schema": 1, "name": "arm", "robot": "galen", "tool": "retractor", "values": {}}',),
    ),
    "file: settings": Target(lambda: own_errors_only(_settings), ((CONFIG / "galen.toml").read_bytes(),)),
    "file: kept state": Target(_kept, (_KEPT,)),
    "recording: CSV": Target(_recording("recording.csv"), (CSV,)),
    "recording: recording.json": Target(_recording("recording.json"), (INFO.encode(),)),
    "recording: Parquet": Target(_recording("recording.parquet"), (_parquet(),)),
    "recording: MCAP": Target(_recording("recording.mcap"), (_mcap(),)),
}
