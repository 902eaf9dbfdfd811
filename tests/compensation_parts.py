"""What the tests of compensation, replay and admittance share: a tool's file, messages, a service on a fresh store."""

from pathlib import Path
from typing import Any

import numpy as np

from galen_hw.clock import TimeBase
from galen_hw.config.tool_file import BiasBody, Origin, ToolFile
from galen_hw.config.tool_store import ToolStore
from galen_hw.kinematics import GalenRobot, Robot
from galen_hw.messages import JointsState, Message, Request, Vector3, WrenchCompensated, WrenchRaw
from galen_hw.physics.rigid import Body, predicted_wrench
from galen_hw.services.compensation.service import CompensationService
from galen_hw.services.compensation.settings import CompensationSettings
from galen_hw.services.service import Output, ServiceContext
from galen_hw.spatial import Array

MS = 1_000_000
BASE = TimeBase(1_700_000_000_000_000_000)
ROBOT = GalenRobot()
RETRACTOR: dict[str, Any] = {
    "name": "retractor",
    "tip": (0.045, 0.0, -0.140),
    "mass": 0.3,
    "com": (0.03, 0.004, -0.06),
    "inertia": ((5e-4, 0.0, 0.0), (0.0, 6e-4, 0.0), (0.0, 0.0, 1e-4)),
    "bias": (0.2, -0.1, 0.4, 0.01, 0.02, -0.03),
    "bias_body": BiasBody(mass=0.09, com=(0.002, -0.001, 0.01)),
    "zeroed_at": dict.fromkeys(ROBOT.joint_names, 0.1),
}


def tool_file(serial: str = "", robot: str = "galen", **changes: Any) -> ToolFile:
    """A calibrated tool."""
    origin = Origin(date="2026-01-01", software="test", robot=robot, method="test", sensor_serial=serial)
    return ToolFile(**(RETRACTOR | {"origin": origin} | changes))


def service_at(folder: Path, *tools: ToolFile, robot: Robot = ROBOT, **settings: Any) -> CompensationService:
    """A service with these tools in its store; the first one is selected."""
    store = ToolStore(folder)
    for tool in tools:
        store.save(tool)
    if tools:
        store.select(tools[0].name)
    return CompensationService("compensation", CompensationSettings(**settings), ServiceContext(robot, BASE, folder))


def true_wrench(tool: ToolFile, q: Array, robot: Robot = ROBOT) -> Array:
    """(6,) what a perfect sensor reads at rest; by the vectorised physics, not by the service's own floats."""
    assert tool.mass is not None
    zeroed = tool.zeroed_at
    R0 = robot.sensor_pose([[zeroed[n] for n in robot.joint_names]])[0, :3, :3] if isinstance(zeroed, dict) else None
    bias_body = tool.bias_body or BiasBody(mass=0.0, com=(0.0, 0.0, 0.0))
    return predicted_wrench(
        robot.sensor_pose(q)[:, :3, :3],
        Body(tool.mass, np.array(tool.com)),
        bias_body=Body(bias_body.mass, np.array(bias_body.com)),
        zeroed_rotation=R0,
        offset=tool.bias,
        gravity=tool.gravity,
    )[0]


def raw(t_ns: int, wrench: Array | list[float], *, seq: int = 0, valid: bool = True, **more: Any) -> WrenchRaw:
    """A raw wrench."""
    f = [float(x) for x in wrench]
    head = {"timestamp": BASE.timestamp(t_ns), "t_ns": t_ns, "seq": seq, "valid": valid, "source": "ft"}
    return WrenchRaw(**(head | {"force": Vector3(*f[:3]), "torque": Vector3(*f[3:])} | more))


def joints(t_ns: int, q: Array, dq: Array | None = None, *, seq: int = 0, valid: bool = True) -> JointsState:
    """A joint state; without `dq` the velocities are not measured."""
    rates = np.full(len(q), np.nan) if dq is None else dq
    names = ROBOT.joint_names
    return JointsState(
        timestamp=BASE.timestamp(t_ns),
        t_ns=t_ns,
        seq=seq,
        valid=valid,
        source="motors",
        position=dict(zip(names, np.asarray(q, dtype=float).tolist(), strict=True)),
        velocity=dict(zip(names, np.asarray(rates, dtype=float).tolist(), strict=True)),
        effort=dict.fromkeys(names, float("nan")),
    )


def messages(outputs: list[Output], topic: str = "wrench/compensated") -> list[Any]:
    """The messages of one topic."""
    return [o[1] for o in outputs if isinstance(o, tuple) and o[0] == topic]


def feed(service: CompensationService, message: Message) -> list[Output]:
    """Hand a message over on its own topic, at its own time."""
    topic = "wrench/raw" if isinstance(message, WrenchRaw) else "joints/state"
    return service.handle(topic, message, message.t_ns)


def six(message: WrenchCompensated | WrenchRaw) -> Array:
    """(6,) force and torque."""
    f, t = message.force, message.torque
    return np.array([f.x, f.y, f.z, t.x, t.y, t.z])


def ask(name: str, **args: Any) -> Request:
    """A request to the compensation."""
    return Request(id=f"r-{name}", target="compensation", name=name, args=args)
