"""`galen-hw replay`: a recording through the services again: verify it, compute it with another tool, or publish it."""

import argparse
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.errors import EXIT_FOUND, EXIT_OK, UsageError

if TYPE_CHECKING:
    from galen_hw.kinematics import Robot
    from galen_hw.recording.mcap_reader import Logged, McapFile
    from galen_hw.services.compensation.replay import Recorded

AXES = ("fx N", "fy N", "fz N", "tx N mm", "ty N mm", "tz N mm")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("recording", metavar="FILE", type=Path, help="MCAP file")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--verify", action="store_true", help="compare every bit with what was recorded; 1 if it differs")
    what.add_argument("--publish", action="store_true", help="publish it on a bus at its own pace, for viewers")
    what.add_argument("--tool", metavar="NAME", help="compensate with this tool's calibration in use instead")
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="times its own pace, with --publish")
    parser.add_argument(
        "--config", metavar="FILE", help="settings whose [bus] says where viewers connect, with --publish"
    )
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the bus, with --publish")
    parser.epilog = "example: galen-hw replay run.mcap --verify"


def run(args: argparse.Namespace) -> int:
    """Replay it."""
    from galen_hw.recording.mcap_reader import McapFile

    if not args.recording.is_file():
        raise UsageError("there is no such recording", where=str(args.recording), todo="give an MCAP file")
    file = McapFile(args.recording)
    logged = file.read()
    for warning in file.warnings:
        print(f"  {warning}")
    if args.publish:
        return publish(logged, args)
    from galen_hw.services.compensation.replay import Recorded

    recorded = Recorded((item.topic, item.message) for item in logged)
    if not recorded.raw:
        file.refuse_nothing("holds no raw wrench")
    with tempfile.TemporaryDirectory() as nowhere:
        robot = robot_of(file)
        if args.verify:
            return _verify(recorded, robot, Path(nowhere))
        return _summary(recorded, robot, Path(nowhere), args.tool)


def robot_of(file: "McapFile") -> "Robot":
    """The robot of a recording that has been read: from the settings attached to it, or the nominal Galen."""
    from galen_hw.config.robot import build_robot
    from galen_hw.config.schema import Config
    from galen_hw.documents import load_toml
    from galen_hw.kinematics import GalenRobot, UrdfRobot

    urdf = file.attachments.get(file.metadata.get("robot_file") or file.metadata.get("robot", ""))
    if urdf:
        known = file.metadata.get
        whole = UrdfRobot(urdf, sensor_link=known("sensor_link") or None, base_link=known("base_link") or None)
        return whole.keeping(whole.moving())
    settings = file.attachments.get("galen.toml")
    if not settings:
        return GalenRobot()
    where = f"{file.path}: galen.toml"
    try:
        robot: dict[str, Any] = load_toml(settings).get("robot", {})
        return build_robot(Config.model_validate({"robot": robot, "devices": {"ft": {"driver": "recorded"}}}))
    except ValueError as error:  # of TOML, or of pydantic
        first = str(error).splitlines()[0]
        raise UsageError(f"the settings in it cannot be used ({first})", where=where, todo="record it again") from None


def _verify(recorded: "Recorded", robot: "Robot", nowhere: Path) -> int:
    from galen_hw.services.compensation.replay import service_for, verify

    if not recorded.compensated or not recorded.states:
        what = "holds no wrench/compensated with its compensation/state, so that there is nothing to verify"
        raise UsageError(what, todo="record all topics")
    verdict = verify(recorded, service_for(recorded, robot, nowhere))
    for why, count in verdict.skipped.items():
        print(f"{count} samples cannot be compared: {why}")
    if verdict.difference is not None:
        print(f"differs after {verdict.compared - 1} equal samples: {verdict.difference}")
        return EXIT_FOUND
    print(f"{verdict.compared} samples are equal, bit for bit")
    return EXIT_OK if verdict.compared else EXIT_FOUND


def _summary(recorded: "Recorded", robot: "Robot", nowhere: Path, tool: str | None) -> int:
    """Compensate again with the recorded parameters or another tool's, and print what is left."""
    import numpy as np

    from galen_hw.config.paths import state_dir
    from galen_hw.services.compensation.replay import again, service_for
    from galen_hw.services.compensation.service import CompensationService
    from galen_hw.services.service import ServiceContext

    service = service_for(recorded, robot, nowhere)
    if tool is not None:
        from galen_hw.clock import TimeBase

        context = ServiceContext(robot, TimeBase(), state_dir(), virtual=None)
        service = CompensationService("compensation", recorded.settings(), context)
        service.take_tool(tool)
    elif recorded.states:
        service.adopt(recorded.states[-1])
    valid = [m for m in again(recorded, service) if m.valid]
    if not valid:
        print("no sample could be compensated: the recording says nothing about the tool; add --tool NAME")
        return EXIT_FOUND
    table = np.array([(m.force.x, m.force.y, m.force.z, m.torque.x, m.torque.y, m.torque.z) for m in valid])
    table[:, 3:] *= 1e3
    raw = np.array([_six(recorded.raw[m.t_ns]) for m in valid])
    raw[:, 3:] *= 1e3
    name = valid[-1].calibration or "no tool"
    print(f"{len(valid)} of {len(recorded.raw)} samples, compensated with {name}")
    print(f"{'':>22}" + "".join(f"{axis:>11}" for axis in AXES))
    for text, values in (("raw, RMS", raw), ("compensated, RMS", table), ("compensated, mean", None)):
        numbers = table.mean(axis=0) if values is None else np.sqrt((values**2).mean(axis=0))
        print(f"{text:>22}" + "".join(f"{x:11.4f}" for x in numbers))
    return EXIT_OK


def _six(message: Any) -> tuple[float, ...]:
    f, t = message.force, message.torque
    return f.x, f.y, f.z, t.x, t.y, t.z


def _viewers(given: str | None) -> str:
    """Where viewers connect, by the settings that a daemon here would read."""
    from galen_hw.config.load import read_document
    from galen_hw.config.paths import config_path
    from galen_hw.config.problems import ConfigError, check
    from galen_hw.config.schema import BusSection

    document, places = read_document(config_path(given))
    section, problems = check(BusSection, document.get("bus", {}), ("bus",), places)
    if not isinstance(section, BusSection):
        raise ConfigError(problems)
    return section.viewers


def publish(logged: "list[Logged]", args: argparse.Namespace) -> int:
    """Put the recorded messages on a bus, at their pace."""
    from galen_hw.bus import TOPIC_BYTES, Batcher, Publisher
    from galen_hw.config.paths import make_runtime, runtime_dir
    from galen_hw.messages import TOPICS, encode
    from galen_hw.permission import socket_mode

    if not 0.0 < args.speed <= 1000.0:
        raise UsageError("must be above 0 and at most 1000", where="--speed", todo="e.g. --speed 1")
    addresses = make_runtime(args.dir or runtime_dir())
    wanted = _viewers(args.config)
    if (addresses.runtime / "command").exists():
        todo = "stop it, or publish elsewhere with --dir"
        raise UsageError("a daemon publishes here", where=str(addresses.runtime), todo=todo)
    known = [item for item in logged if item.topic in TOPICS]
    with ExitStack() as stack:
        mode = socket_mode(addresses.runtime)
        bus = stack.enter_context(Publisher(addresses.bus, mode=mode))
        batcher = Batcher(addresses.batches, mode=mode)
        for name in ("bus.pub", "batches"):
            stack.callback((addresses.runtime / name).unlink, missing_ok=True)
        stack.callback(batcher.close)
        places = [addresses.bus, *([bus.offer(wanted)] if wanted else [])]
        print(f"publishing {len(known)} messages at {' and '.join(places)}; Ctrl-C ends it", flush=True)
        begin, first = time.monotonic(), known[0].log_ns if known else 0
        for item in known:
            ahead = (item.log_ns - first) * 1e-9 / args.speed - (time.monotonic() - begin)
            if ahead > 1e-3:
                batcher.send()
                time.sleep(ahead)
            topic, payload = TOPIC_BYTES[item.topic], encode(item.message)
            bus.publish_bytes(topic, payload)
            batcher.add(topic, payload)
    return EXIT_OK
