"""One recording of the bus: messages in, an MCAP file out, with what they belong to."""

from typing import IO

from galen_hw.errors import HardwareError
from galen_hw.messages import CompensationState, Message, WrenchRaw
from galen_hw.recording.mcap_writer import Encoding, McapWriter


class Session:
    """Writes messages, and beside them the robot, the tool's file and the serial number as they become known.

    Args:
        stream: binary, where to.
        robot: name of the robot; urdf: its text if it is not a Galen.
        links: base and sensor link in that URDF.
        config: text of the configuration; virtual: the robot is a virtual one.
        encoding: of the messages.

    `add`, `flush` and `finish` raise HardwareError when the file cannot be written (a full disk): it is then ended and
    closed with the messages of the last `flush`, whose number is `messages`.
    """

    def __init__(
        self,
        stream: IO[bytes],
        *,
        robot: str = "",
        urdf: str = "",
        links: dict[str, str] | None = None,
        config: str = "",
        virtual: bool = False,
        encoding: Encoding = "json",
    ) -> None:
        known = {"robot": robot, "robot_file": "robot.urdf" if urdf else ""} | (links or {})
        known |= {"virtual": "true"} if virtual else {}
        self._stream = stream
        self._writer = McapWriter(stream, encoding=encoding, metadata=known)
        self._known = dict.fromkeys(("serial_number", "calibration", "tool"), "")
        self._last: dict[tuple[str, str], int] = {}
        self._flushed = 0
        self.broken = False
        """The file could not be written any further and is closed."""
        self.messages = 0
        self.lost = 0
        if urdf:
            self._writer.attach("robot.urdf", urdf, media_type="application/xml")
        if config:
            self._writer.attach("galen.toml", config, media_type="application/toml")

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        return self._writer.counts

    def add(self, topic: str, message: Message, log_ns: int) -> None:
        """Take one message; `log_ns` is when it arrived, ns since the epoch.

        Raises:
            HardwareError: the file cannot be written; see the class.
        """
        try:
            self._add(topic, message, log_ns)
        except OSError as error:
            raise self._break(error) from None

    def _add(self, topic: str, message: Message, log_ns: int) -> None:
        if isinstance(message, WrenchRaw):
            self._learn(serial_number=message.serial_number)
        elif isinstance(message, CompensationState):
            if message.calibration and message.calibration != self._known["calibration"]:
                self._writer.attach(f"tool/{message.calibration}.json", message.tool_file, log_ns)
            self._learn(calibration=message.calibration, tool=message.tool)
        key = (topic, message.source)
        last = self._last.get(key, message.seq - 1)
        self.lost += max(0, message.seq - last - 1)
        self._last[key] = message.seq
        self._writer.message(topic, message, log_ns)
        self.messages += 1

    def _learn(self, **values: str) -> None:
        new = {key: value for key, value in values.items() if value and value != self._known[key]}
        if new:
            self._known.update(new)
            self._writer.metadata(new)

    def flush(self) -> None:
        """Put what came so far on the disk.

        Raises:
            HardwareError: the file cannot be written; see the class.
        """
        try:
            self._writer.flush()
        except OSError as error:
            raise self._break(error) from None
        self._flushed = self.messages

    def finish(self) -> None:
        """Write the index and end the file, unless it is ended already.

        Raises:
            HardwareError: the file cannot be written; see the class.
        """
        if self.broken:
            return
        try:
            self._writer.flush()
            self._flushed = self.messages
            self._writer.finish()
        except OSError as error:
            raise self._break(error) from None

    def _break(self, error: OSError) -> HardwareError:
        self.broken, self.messages = True, self._flushed
        self._writer.abandon()
        what = f"cannot be written any further ({error.strerror}); it holds {self.messages} messages and is closed"
        return HardwareError(what, where=str(getattr(self._stream, "name", "")), todo="make room, then record again")
