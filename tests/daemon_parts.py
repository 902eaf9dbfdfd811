"""Small real devices and services that the tests of the daemon run in its own processes, over real wires."""

import os
import select
import time
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import Device, Output
from galen_hw.drivers.transport import Transport
from galen_hw.errors import CommandRejectedError, HardwareError
from galen_hw.messages import JointsState, Message, Reply, Request, Vector3, WrenchCompensated, WrenchRaw
from galen_hw.services.service import Output as ServiceOutput
from galen_hw.services.service import Service, ServiceContext

FAR = 1 << 60


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PtyTransport(Transport[bytes]):
    """Lines over a pty or any file that can be read and written."""

    class Settings(Strict):
        url: str
        with_fd: bool = True

    def __init__(self, settings: Settings) -> None:
        self.address, self._with_fd = settings.url, settings.with_fd
        self._fd = -1
        self._counters = {"bytes_in": 0, "bytes_out": 0}

    def open(self) -> None:
        try:
            self._fd = os.open(self.address, os.O_RDWR | os.O_NOCTTY)
        except OSError as error:
            raise HardwareError(error.strerror or "?", where=self.address, todo="plug it in") from None

    def send(self, wires: list[bytes]) -> None:
        try:
            self._counters["bytes_out"] += sum(os.write(self._fd, wire) for wire in wires)
        except OSError as error:
            raise HardwareError(error.strerror or "?", where=self.address) from None

    def receive(self, timeout_s: float) -> list[tuple[bytes, int]]:
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return []
        try:
            data = os.read(self._fd, 65536)
        except OSError as error:
            raise HardwareError(error.strerror or "?", where=self.address, todo="plug it in") from None
        t_ns = time.monotonic_ns()
        if not data:
            raise HardwareError("the far end is gone", where=self.address, todo="plug it in")
        self._counters["bytes_in"] += len(data)
        return [(data, t_ns)]

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def fileno(self) -> int | None:
        return self._fd if self._with_fd else None

    @property
    def counters(self) -> dict[str, int]:
        return self._counters


class LineDevice(Device[bytes]):
    """Each line is a sample; `say` sends a line; the reply to `say` comes with the next line."""

    wire: ClassVar[Literal["serial"]] = "serial"

    class Settings(Strict):
        rest: str = "REST"
        gain: float = 1.0

    def __init__(self, name: str, settings: Settings, time_base: TimeBase) -> None:
        self.name, self._settings, self._time_base = name, settings, time_base
        self._buffer, self._out, self._asked = b"", [], []
        self._seq = 0

    def start(self, now_ns: int) -> None:
        self._buffer, self._out = b"", [b"HELLO\n"]
        self._seq = 0

    def poll(self, now_ns: int) -> tuple[list[bytes], list[Output]]:
        out, self._out = self._out, []
        return out, []

    def feed(self, wire: bytes, t_ns: int) -> list[Output]:
        *lines, self._buffer = (self._buffer + wire).split(b"\n")
        outputs: list[Output] = []
        for line in lines:
            self._seq += 1
            outputs.append(self.message(line, t_ns))
            outputs += [Reply(id=i, result={"line": line.decode()}) for i in self._asked]
            self._asked = []
        return outputs

    def message(self, line: bytes, t_ns: int) -> tuple[str, Message]:
        raise NotImplementedError

    def header(self, t_ns: int) -> dict[str, Any]:
        stamp = self._time_base.timestamp(t_ns)
        return {"timestamp": stamp, "t_ns": t_ns, "seq": self._seq, "valid": True, "source": self.name}

    def request(self, request: Request, now_ns: int) -> list[Output]:
        if request.name == "die":
            os._exit(9)
        if request.name == "stop":
            self._out.append(b"STOP\n")
            return [Reply(id=request.id)]
        if request.name == "silence":
            return []
        if request.name != "say":
            raise CommandRejectedError(f"no command {request.name!r}", where=self.name, todo="one of: say")
        self._out.append(f"{request.args['text']}\n".encode())
        self._asked.append(request.id)
        return []

    def stop(self, now_ns: int) -> list[bytes]:
        return [f"{self._settings.rest}\n".encode()]

    @property
    def wakeup_ns(self) -> int:
        return 0 if self._out else FAR

    @property
    def ready(self) -> bool:
        return self._seq > 0

    @property
    def counters(self) -> dict[str, int]:
        return {"samples": self._seq}


class LineSensor(LineDevice):
    """A line is the force along z."""

    def message(self, line: bytes, t_ns: int) -> tuple[str, Message]:
        force = Vector3(z=float(line))
        return "wrench/raw", WrenchRaw(**self.header(t_ns), force=force, torque=Vector3(), serial_number="T1")


class LineMotors(LineDevice):
    """A line is the roll angle, or the word `moving`."""

    def message(self, line: bytes, t_ns: int) -> tuple[str, Message]:
        roll = 0.0 if line == b"moving" else float(line)
        state = {"position": {"roll": roll}, "velocity": {"roll": 0.0}, "effort": {"roll": 0.0}}
        return "joints/state", JointsState(**self.header(t_ns), **state, moving={"roll": line == b"moving"})


class Compensation(Service):
    """Raw less the last roll angle, so that both inputs show in the output."""

    consumes = ("wrench/raw", "joints/state")
    produces = ("wrench/compensated",)

    class Settings(Strict):
        offset: float = 0.0

    def __init__(self, name: str, settings: Settings, context: ServiceContext) -> None:
        self.name, self._offset, self._context = name, settings.offset, context
        self._roll, self._seq = 0.0, 0

    def handle(self, topic: str, message: Message, now_ns: int) -> list[ServiceOutput]:
        if isinstance(message, JointsState):
            self._roll = message.position.get("roll", 0.0)
        if not isinstance(message, WrenchRaw):
            return []
        self._seq += 1
        force = Vector3(z=message.force.z - self._roll - self._offset)
        out = WrenchCompensated(
            timestamp=message.timestamp,
            t_ns=message.t_ns,
            seq=self._seq,
            valid=True,
            source=self.name,
            force=force,
            torque=message.torque,
        )
        return [("wrench/compensated", out)]

    def request(self, request: Request, now_ns: int) -> list[ServiceOutput]:
        if request.name == "fail":
            raise RuntimeError("a bug")
        if request.name != "offset":
            raise CommandRejectedError(f"no command {request.name!r}", where=self.name, todo="one of: offset")
        self._offset = float(request.args["value"])
        return [Reply(id=request.id, result={"offset": self._offset})]

    def snapshot(self) -> dict[str, Any]:
        return {"version": 1, "identity": self._context.identity, "offset": self._offset}

    def restore(self, state: dict[str, Any]) -> bool:
        if state.get("version") != 1 or state.get("identity") != self._context.identity:
            return False
        self._offset = float(state["offset"])
        return True


class Calibration(Service):
    """Passes `zero` on to the sensor of another process and answers when that has answered."""

    consumes = ("wrench/raw",)
    produces = ()

    class Settings(Strict):
        pass

    def __init__(self, name: str, settings: Settings, context: ServiceContext) -> None:
        self.name, self._context = name, context
        self._heard, self._asked = 0, ""

    def handle(self, topic: str, message: Message, now_ns: int) -> list[ServiceOutput]:
        self._heard += 1
        return []

    def request(self, request: Request, now_ns: int) -> list[ServiceOutput]:
        if request.name == "heard":
            return [Reply(id=request.id, result={"heard": self._heard})]
        self._asked = request.id
        target = str(request.args.get("target", self._context.sensor))
        return [Request(id="mine", target=target, name="say", args={"text": "ZERO"})]

    def reply(self, reply: Reply, now_ns: int) -> list[ServiceOutput]:
        assert reply.id == "mine"
        return [Reply(id=self._asked, result=reply.result, error=reply.error)]

    def snapshot(self) -> dict[str, Any]:
        return {"version": 1}

    def restore(self, state: dict[str, Any]) -> bool:
        return True
