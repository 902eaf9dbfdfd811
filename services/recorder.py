"""The recorder as a service: start and stop by command, in a process of its own.

The only service that writes files: it owns its process, so that a slow disk delays nobody. `galen-hw record` does the
same from outside and needs no section in the configuration.
"""

from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, ClassVar, Final

from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.errors import CommandRejectedError, UsageError
from galen_hw.messages import TOPICS, Message, Reply, Request, Status
from galen_hw.recording.mcap_writer import Encoding
from galen_hw.recording.session import Session
from galen_hw.services.service import Output, Service, ServiceContext

FLUSH_NS: Final = NS_PER_S
CONTEXT_TOPIC: Final = "compensation/state"
"""Recorded whatever the selection: it says which tool the wrench belongs to."""


class RecorderSettings(BaseModel):
    """Settings of the recorder.

    Args:
        directory: for files whose name is not given; below the state directory if None.
        encoding: of the messages, see `docs/recording.md`.
        start_at_once: record from the start of the daemon on.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    directory: Path | None = Field(default=None, examples=["/var/lib/galen-hw/recordings"])
    encoding: Encoding = "json"
    start_at_once: bool = False


class RecorderService(Service):
    """Records the bus; see `Service` for the arguments.

    Requests: start {file, topics}, both optional; stop.
    """

    Settings: ClassVar[type[BaseModel]] = RecorderSettings
    consumes: ClassVar[tuple[str, ...]] = tuple(TOPICS)
    produces: ClassVar[tuple[str, ...]] = ("status",)
    takes_old: ClassVar[bool] = True

    def __init__(self, name: str, settings: RecorderSettings, context: ServiceContext) -> None:
        self.name, self._settings, self._context = name, settings, context
        self._stream: IO[bytes] | None = None
        self._session: Session | None = None
        self._path = Path()
        self._topics: frozenset[str] = frozenset()
        self._next_ns = self._seq = 0
        if settings.start_at_once:
            self._start({})

    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Write a message down, if it is wanted."""
        if self._session is not None and topic in self._topics:
            self._session.add(topic, message, now_ns + self._context.time_base.wall_minus_monotonic_ns)
        return []

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Start or stop.

        Raises:
            CommandRejectedError: not now, or not known.
            UsageError: the file is there already or cannot be written, or no such topic.
        """
        del now_ns
        if request.name == "start":
            if self._session is not None:
                raise CommandRejectedError("recording already", where=str(self._path), todo="stop it first")
            self._start(request.args)
            return [Reply(id=request.id, result={"file": str(self._path)})]
        if request.name == "stop":
            if self._session is None:
                raise CommandRejectedError("nothing is being recorded", where=self.name, todo="start first")
            messages = self._session.messages
            self._stop()
            return [Reply(id=request.id, result={"file": str(self._path), "messages": messages})]
        raise CommandRejectedError(f"no command {request.name!r}", where=self.name, todo="one of: start, stop")

    def close(self) -> None:
        """Finish the recording that runs."""
        if self._session is not None:
            self._stop()

    def _start(self, args: dict[str, Any]) -> None:
        self._topics = chosen_topics(args.get("topics") or [])
        directory = self._settings.directory or self._context.state_dir / "recordings"
        path = Path(args["file"]) if args.get("file") else directory / default_name(datetime.now(UTC))
        self._stream = open_new(path)
        self._path = path
        context = self._context
        virtual = bool(context.virtual)
        encoding = self._settings.encoding
        self._session = Session(self._stream, robot=context.robot.name, virtual=virtual, encoding=encoding)

    def _stop(self) -> None:
        assert self._session is not None
        assert self._stream is not None
        self._session.finish()
        self._stream.close()
        self._session = self._stream = None

    def tick(self, now_ns: int) -> list[Output]:
        """Once a second: put what came on the disk, and say how far it is."""
        if now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + FLUSH_NS
        counters = {"messages": 0, "lost": 0}
        if self._session is not None:
            self._session.flush()
            counters = {"messages": self._session.messages, "lost": self._session.lost}
        detail = f"recording to {self._path}" if self._session is not None else "not recording"
        self._seq += 1
        status = Status(
            timestamp=self._context.time_base.timestamp(now_ns),
            t_ns=now_ns,
            seq=self._seq - 1,
            valid=True,
            source=self.name,
            state="ready",
            detail=detail,
            counters=counters,
        )
        return [("status", status)]

    def snapshot(self) -> dict[str, Any]:
        """Nothing is worth keeping: a recording ends with the process."""
        return {"version": 1, "identity": self._context.identity}

    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back."""
        return (state.get("version"), state.get("identity")) == (1, self._context.identity)


def chosen_topics(prefixes: list[str]) -> frozenset[str]:
    """Topics that begin with one of the prefixes (all if there are none), and what a reader needs beside them.

    Raises:
        UsageError: a prefix is that of no topic.
    """
    if not prefixes:
        return frozenset(TOPICS)
    for prefix in prefixes:
        if not any(topic.startswith(prefix) for topic in TOPICS):
            raise UsageError(f"no topic begins with {prefix!r}", todo=f"topics: {', '.join(TOPICS)}")
    return frozenset(topic for topic in TOPICS if topic.startswith(tuple(prefixes))) | {CONTEXT_TOPIC}


def default_name(now: datetime) -> str:
    """Name of a recording that is begun now (UTC)."""
    return f"galen-{now:%Y%m%d-%H%M%S}.mcap"


def open_new(path: Path, *, overwrite: bool = False) -> IO[bytes]:
    """Create a file; nothing is overwritten unless told so.

    Raises:
        UsageError: it is there already, or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("wb" if overwrite else "xb")
    except FileExistsError:
        raise UsageError("is there already", where=str(path), todo="give another name with -o, or --force") from None
    except OSError as error:
        todo = "give a place that can be written"
        raise UsageError(f"cannot be written ({error.strerror})", where=str(path), todo=todo) from None
