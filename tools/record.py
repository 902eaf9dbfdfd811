"""`galen-hw record`: the bus to an MCAP file."""

import argparse
import signal
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from galen_hw.clock import TimeBase
from galen_hw.errors import EXIT_OK, GalenError, HardwareError, UsageError
from galen_hw.units import number_in

if TYPE_CHECKING:
    from galen_hw.bus import Subscriber
    from galen_hw.recording.session import Session

SILENCE_S: Final = 5.0
QUEUE: Final = 50_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="default: galen-DATE-TIME.mcap here")
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="or beginnings of topics; default all")
    parser.add_argument("--seconds", type=number_in("s"), metavar="S", help="end after so long; default: until Ctrl-C")
    parser.add_argument(
        "--encoding",
        choices=("json", "msgpack"),
        default="json",
        help="json opens in Foxglove, Lichtblick and PlotJuggler; msgpack in PlotJuggler, for less work",
    )
    parser.add_argument("--overwrite", action="store_true", help="overwrite the file")
    parser.add_argument("--config", metavar="FILE", help="settings to attach (default: those of the daemon)")
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.add_argument("--virtual", action="store_true", help="start a daemon on a virtual robot and record that")
    parser.epilog = "example: galen-hw record -o run.mcap --seconds 30"


def run(args: argparse.Namespace) -> int:
    """Record until Ctrl-C, SIGTERM, or the time is over."""
    from datetime import UTC, datetime

    from galen_hw.bus import Subscriber
    from galen_hw.config.paths import Addresses, client_runtime_dir, config_path
    from galen_hw.daemon.session import own_daemon
    from galen_hw.recording.session import Session
    from galen_hw.services.recorder import chosen_topics, default_name, open_new

    if args.seconds is not None and not 0.0 < args.seconds < 1e7:
        raise UsageError("must be a number of seconds above 0", where="--seconds", todo="e.g. --seconds 30")
    topics = chosen_topics(args.topics)
    path = args.output or Path(default_name(datetime.now(UTC)))
    if path.exists() and not args.overwrite:
        raise UsageError("is there already", where=str(path), todo="give another name with -o, or --overwrite")
    if args.virtual and not path.exists():  # Not after the start of a robot.
        open_new(path).close()
        path.unlink()
    with ExitStack() as stack:
        if args.virtual:
            addresses = stack.enter_context(own_daemon(config=args.config, runtime=args.dir))
        else:
            addresses = Addresses(args.dir or client_runtime_dir())
            addresses.require_daemon()
        subscriber = stack.enter_context(Subscriber(addresses.bus, topics, queue=QUEUE, as_published=True))
        info = _daemon_info(addresses.command)
        context = session_context(Path(args.config or info.get("config") or config_path(None)))
        context["virtual"] = bool(info.get("virtual"))
        stream = stack.enter_context(open_new(path, overwrite=args.overwrite))
        session = Session(stream, encoding=args.encoding, **context)
        try:
            heard = record(subscriber, session, args.seconds)
        except HardwareError:
            if not session.messages:
                path.unlink()
            raise
    if not heard:
        path.unlink()
        raise HardwareError(
            f"nothing was published within {SILENCE_S:g} s",
            where=addresses.bus.removeprefix("ipc://"),
            todo="galen-hw monitor, galen-hw check",
        )
    print(f"{path}: {heard} messages")
    return EXIT_OK


def session_context(path: Path) -> dict[str, Any]:
    """What a session should know of the robot, from the settings in the file `path`."""
    from galen_hw.config.schema import RobotSection
    from galen_hw.documents import load_toml

    try:
        text = path.read_text(encoding="utf-8")
        robot = RobotSection.model_validate(load_toml(text).get("robot", {}))
        urdf = robot.urdf.read_text(encoding="utf-8") if robot.urdf is not None else ""
    except (OSError, ValueError) as error:
        first = str(error).splitlines()[0]
        raise UsageError(f"cannot be attached ({first})", where=str(path), todo="galen-hw check") from error
    links = {key: value for key in ("base_link", "sensor_link") if (value := getattr(robot, key))}
    return {"robot": robot.name, "urdf": urdf, "links": links, "config": text}


def _daemon_info(command: str) -> dict[str, Any]:
    """What the running daemon says of itself: the file that it has read, and whether its robot is virtual."""
    from galen_hw.bus import CommandClient

    with suppress(GalenError), CommandClient(command) as client:
        return client.call("daemon", "info", timeout_s=2.0)
    return {}


def record(subscriber: "Subscriber", session: "Session", seconds: float | None) -> int:
    """Record until told to stop; the number of messages. The file is complete at the end, whatever ended it.

    Raises:
        HardwareError: the disk is full; what was written until the last second is in the file.
    """
    base = TimeBase.now()  # A wall clock that is set meanwhile would turn messages round.
    stopped: list[int] = []
    before = {s: signal.signal(s, lambda number, _: stopped.append(number)) for s in (signal.SIGINT, signal.SIGTERM)}
    begin = last = time.monotonic()
    try:
        while not stopped and (seconds is None or time.monotonic() - begin < seconds):
            received = subscriber.receive(0.1)
            if received is not None:
                session.add(*received, time.monotonic_ns() + base.wall_minus_monotonic_ns)
            elif not session.messages and time.monotonic() - begin > SILENCE_S:
                break
            if time.monotonic() - last >= 1.0:
                last = time.monotonic()
                session.flush()
                _progress(session, last - begin)
    finally:
        session.finish()
        for number, handler in before.items():
            signal.signal(number, handler)
        if sys.stderr.isatty():
            print(file=sys.stderr)
    return session.messages


def _progress(session: "Session", seconds: float) -> None:
    if sys.stderr.isatty():
        rates = ", ".join(f"{topic} {count / seconds:.0f}/s" for topic, count in list(session.counts.items())[:3])
        text = f"\r{seconds:6.0f} s  {session.messages} messages, {session.lost} lost  ({rates})  Ctrl-C ends it"
        print(text, end="", file=sys.stderr, flush=True)
