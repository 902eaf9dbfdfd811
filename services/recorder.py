"""The recorder as a service: start and stop by command, in a process of its own.

The only service that writes files: it owns its process, so that a slow disk delays nobody. `galen-hw record` does the
same from outside and needs no section in the configuration.
"""

import shutil
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, ClassVar, Final

from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.errors import CommandRejectedError, GalenError, HardwareError, UsageError, WrongCommandError
from galen_hw.messages import TOPICS, Fault, Message, Reply, Request, Status
from galen_hw.recording.mcap_writer import Encoding
from galen_hw.recording.session import Session
from galen_hw.services.service import Output, Service, ServiceContext

FLUSH_NS: Final = NS_PER_S
RETRY_NS: Final = 10 * NS_PER_S
CONTEXT_TOPIC: Final = "compensation/state"
"""Recorded whatever the selection: it says which tool the wrench belongs to."""
ROOM: Final = "make room on the disk, or give another directory in [services.recorder]"


class RecorderSettings(BaseModel):
    """Settings of the recorder.

    Args:
        directory: of all files; `recordings` below the state directory if None.
        encoding: of the messages, see `docs/recording.md`.
        start_at_once: record from the start of the daemon on; what cannot be begun, or ended by itself, is begun again
            in a new file as soon as that is possible.
        keep_free_mb: a recording ends, whole, when the disk has less room left: calibrations need it too; 0 for never.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    directory: Path | None = Field(default=None, examples=["/var/lib/galen-hw/recordings"])
    encoding: Encoding = "json"
    start_at_once: bool = False
    keep_free_mb: float = Field(default=100.0, ge=0.0, le=1e9)


class RecorderService(Service):
    """Records the bus; see `Service` for the arguments.

    Requests: start {file, topics}, both optional; stop. A disk that is full ends the recording, never the service.
    """

    Settings: ClassVar[type[BaseModel]] = RecorderSettings
    consumes: ClassVar[tuple[str, ...]] = tuple(TOPICS)
    produces: ClassVar[tuple[str, ...]] = ("status", "fault")
    takes_old: ClassVar[bool] = True

    def __init__(self, name: str, settings: RecorderSettings, context: ServiceContext) -> None:
        self.name, self._settings, self._context = name, settings, context
        self._folder = settings.directory or context.state_dir / "recordings"
        self._stream: IO[bytes] | None = None
        self._session: Session | None = None
        self._path = Path()
        self._topics: frozenset[str] = frozenset()
        self._next_ns = self._retry_ns = 0
        self._seq = dict.fromkeys(self.produces, 0)
        self._unasked = settings.start_at_once
        """Begin again without being asked; ends with a `stop`."""
        self._problem: GalenError | None = None
        self._untold: list[GalenError] = []
        if self._unasked:
            self._begin_unasked()

    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Write a message down, if it is wanted."""
        if self._session is not None and topic in self._topics:
            try:
                self._session.add(topic, message, now_ns + self._context.time_base.wall_minus_monotonic_ns)
            except HardwareError as error:
                self._give_up(error, now_ns)
        return []

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Start or stop.

        Raises:
            CommandRejectedError: not now, or not known.
            UsageError: the file is there already, is not below the folder or cannot be written, or no such topic.
        """
        del now_ns
        if request.name not in ("start", "stop"):
            raise WrongCommandError(f"no command {request.name!r}", where=self.name, todo="one of: start, stop")
        if request.name == "start":
            request.require_only("file", "topics")
            if self._session is not None:
                raise CommandRejectedError("recording already", where=str(self._path), todo="stop it first")
            topics = chosen_topics(request.args.get("topics") or [])
            file = request.args.get("file")
            self._begin(place_below(self._folder, file) if file else self._new_path(), topics)
            return [Reply(id=request.id, result={"file": str(self._path)})]
        request.require_only()
        return [Reply(id=request.id, result=self._stop())]

    def _stop(self) -> dict[str, Any]:
        session = self._session
        if session is None and not self._unasked:
            raise CommandRejectedError("nothing is being recorded", where=self.name, todo="start first")
        self._unasked, self._problem = False, None
        if session is None:  # it was to begin as soon as it can
            return {"file": "", "messages": 0}
        self._finish()
        return {"file": str(self._path), "messages": session.messages}

    def close(self) -> None:
        """Finish the recording that runs."""
        if self._session is not None:
            with suppress(HardwareError):
                self._finish()

    def _new_path(self) -> Path:
        return self._folder / default_name(datetime.now(UTC))

    def _begin(self, path: Path, topics: frozenset[str]) -> None:
        """Begin a file; what cannot be begun leaves none."""
        stream = open_new(path)
        try:
            context = self._context
            session = Session(
                stream, robot=context.robot.name, virtual=bool(context.virtual), encoding=self._settings.encoding
            )
            session.flush()
            self._look_for_room(path)
        except (OSError, HardwareError) as error:
            _drop(stream, path)
            what = error.what if isinstance(error, HardwareError) else f"cannot be written ({error.strerror})"
            raise HardwareError(what, where=str(path), todo=ROOM) from None
        self._stream, self._session, self._path, self._topics = stream, session, path, topics
        self._problem, self.keep_now = None, True

    def _begin_unasked(self) -> None:
        """Begin a recording that nobody waits for; why not is told, and it is tried again."""
        try:
            self._begin(self._new_path(), chosen_topics([]))
        except GalenError as error:
            if str(error) != str(self._problem):
                self._untold.append(error)
            self._problem = error

    def _finish(self) -> None:
        """End the file with its index.

        Raises:
            HardwareError: there is no room for the index; what was written before is whole.
        """
        session, stream = self._session, self._stream
        assert session is not None
        assert stream is not None
        self._session = self._stream = None
        self.keep_now = True
        try:
            session.finish()
        finally:
            if not session.broken:
                stream.close()

    def _give_up(self, error: HardwareError, now_ns: int) -> None:
        """End a recording that cannot go on, and say so."""
        try:
            self._finish()
        except HardwareError as worse:
            error = worse
        self._problem, self._retry_ns = error, now_ns + RETRY_NS
        self._untold.append(error)

    def _look_for_room(self, path: Path) -> None:
        """Raises HardwareError when the disk has less room than is to be kept."""
        free_mb = shutil.disk_usage(path.parent).free / 1e6
        if free_mb < self._settings.keep_free_mb:
            what = f"the disk has {free_mb:.0f} MB left, {self._settings.keep_free_mb:g} MB are kept free"
            raise HardwareError(what, where=str(path), todo=ROOM)

    def tick(self, now_ns: int) -> list[Output]:
        """Once a second: put what came on the disk, and say how far it is."""
        if now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + FLUSH_NS
        if self._session is not None:
            try:
                self._session.flush()
                self._look_for_room(self._path)
            except HardwareError as error:
                self._give_up(error, now_ns)
            except OSError:
                pass  # How much room there is cannot be said; the next write tells.
        elif self._unasked and now_ns >= self._retry_ns:
            self._retry_ns = now_ns + RETRY_NS
            self._begin_unasked()
        untold, self._untold = self._untold, []
        faults = [
            Fault(**self._header("fault", now_ns), what=e.what, where=e.where or self.name, todo=e.todo) for e in untold
        ]
        return [("status", self._status(now_ns)), *(("fault", fault) for fault in faults)]

    def _status(self, now_ns: int) -> Status:
        session, state, todo = self._session, "ready", ""
        counters = {"messages": 0, "lost": 0}
        detail = "not recording"
        if session is not None:
            counters = {"messages": session.messages, "lost": session.lost}
            detail = f"recording to {self._path}"
        elif self._problem is not None:
            state, detail, todo = "fault", f"not recording: {self._problem.problem}", self._problem.todo
            detail += "; tried again every 10 s" if self._unasked else ""
        return Status(**self._header("status", now_ns), state=state, detail=detail, counters=counters, todo=todo)

    def _header(self, topic: str, t_ns: int) -> dict[str, Any]:
        self._seq[topic] += 1
        timestamp = self._context.time_base.timestamp(t_ns)
        seq = self._seq[topic] - 1
        return {"timestamp": timestamp, "t_ns": t_ns, "seq": seq, "valid": True, "source": self.name}

    def snapshot(self) -> dict[str, Any]:
        """What is being recorded: should the process be killed, the next one knows that it was."""
        recording = {} if self._session is None else {"file": str(self._path), "topics": sorted(self._topics)}
        return {
            "version": 1,
            "identity": self._context.identity,
            "daemon": self._context.time_base.wall_minus_monotonic_ns,
            "recording": recording,
        }

    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back: a recording that was cut off goes on in a new file within the same daemon, and is told."""
        if (state.get("version"), state.get("identity")) != (1, self._context.identity):
            return False
        recording = state.get("recording")
        if not isinstance(recording, dict) or not isinstance(recording.get("file"), str):
            return True
        file, same = recording["file"], state.get("daemon") == self._context.time_base.wall_minus_monotonic_ns
        try:
            if self._session is None and same:
                topics = recording.get("topics")
                self._begin(self._new_path(), chosen_topics(topics if isinstance(topics, list) else []))
        except GalenError as error:
            self._problem = error
        goes_on = f"goes on in {self._path}" if self._session is not None else "nothing is being recorded"
        todo = "" if self._session is not None else "start it again"
        what = f"the recorder was killed and its file cut off, with all but the last second in it; {goes_on}"
        self._untold.append(HardwareError(what, where=file, todo=todo))
        return True


def place_below(folder: Path, file: object) -> Path:
    """The path of a file that was asked for by name, which must lie below a folder, links followed.

    Raises:
        UsageError: it does not, or is no name.
    """
    if not isinstance(file, str) or "\0" in file:
        raise UsageError("file must be a name", where=repr(file)[:100], todo="e.g. run.mcap")
    try:
        root = folder.resolve()
        path = (root / file).resolve()
    except (OSError, RuntimeError) as error:  # links in a circle, names that are too long
        raise UsageError(f"is no place for a file ({error})", where=file[:100], todo="e.g. run.mcap") from None
    if root not in path.parents:
        raise UsageError("is not below the recorder's directory", where=file[:100], todo=f"a name below {root}")
    return path


def _drop(stream: IO[bytes], path: Path) -> None:
    """Close and remove a file that was begun in vain."""
    with suppress(OSError):
        stream.close()
    with suppress(OSError):
        path.unlink()


def chosen_topics(prefixes: list[str]) -> frozenset[str]:
    """Topics that begin with one of the prefixes (all if there are none), and what a reader needs beside them.

    Raises:
        UsageError: a prefix is that of no topic.
    """
    if not isinstance(prefixes, list) or not all(isinstance(prefix, str) for prefix in prefixes):
        raise UsageError("topics must be a list of names", todo='e.g. ["wrench/", "joints/state"]')
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
        raise UsageError(
            "is there already", where=str(path), todo="give another name with -o, or --overwrite"
        ) from None
    except OSError as error:
        todo = "give a place that can be written"
        raise UsageError(f"cannot be written ({error.strerror})", where=str(path), todo=todo) from None
