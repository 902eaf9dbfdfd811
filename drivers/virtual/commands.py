"""What the control socket can do to the world: one method a word, `do` names it, the other keys are its arguments."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from galen_hw.drivers.virtual.effects import Cable, Drift, Thermal
from galen_hw.drivers.virtual.faults import parse_fault
from galen_hw.drivers.virtual.give import Compliance
from galen_hw.drivers.virtual.ports import Port
from galen_hw.drivers.virtual.world import World
from galen_hw.errors import GalenError, UsageError
from galen_hw.spatial import Array

_ESTOP: Final = "elo"
_MOTOR_FAULTS: Final = {
    _ESTOP: "the emergency stop is pressed",
    "abort_input": "the abort input of the motor controller is pulled",
    "motors.blocked": "the joint of that name does not move",
    "motors.silent": "the motor controller answers nothing",
    "motors.late": "the motor controller answers a second late",
}


class Commands:
    """The words of the control socket.

    Args:
        world: that is changed.
        devices: by the name of their wire (`can0`, `motors`, `tracker`).
        ports: where they are.
        clock: nanoseconds on the process's clock.
    """

    def __init__(
        self, world: World, devices: Mapping[str, Any], ports: Mapping[str, Port], clock: Callable[[], int]
    ) -> None:
        self._world, self._devices, self._ports, self._clock = world, devices, ports, clock
        self.stopped = False
        self.stalls = 0
        """How often this process was kept from running for so long that a host may have given up an answer."""
        words = (
            "attach_tool push guide contact release drift thermal cable compliance fault estop noise power_cycle "
            "inertial state stop"
        )
        self._words: dict[str, Callable[..., dict[str, Any] | None]] = {w: getattr(self, w) for w in words.split()}

    def carry_out(self, request: Any) -> dict[str, Any]:
        """The reply: {"result": {...}} or {"error": one line}; a wrong request changes nothing."""
        try:
            if not isinstance(request, dict) or request.get("do") not in self._words:
                raise UsageError("not a request", where="control", todo=f'{{"do": one of {", ".join(self._words)}}}')
            word = self._words[request.pop("do")]
            inspect.signature(word).bind(**request)
            self._world.advance(self._clock())
            return {"result": word(**request) or {}}
        except GalenError as error:
            return {"error": str(error)}
        except (TypeError, ValueError) as error:
            return {"error": f"control: {error}"}

    def attach_tool(self, tool: Any) -> None:
        """A name, numbers, or None."""
        self._world.attach(tool)

    def push(self, force: Any = (0, 0, 0), torque: Any = (0, 0, 0), seconds: float = 1.0, rise_s: float = 0.0) -> None:
        """See `World.push`."""
        self._world.push(_numbers(force, 3), _numbers(torque, 3), float(seconds), float(rise_s))

    def guide(self, by: Any = (0, 0, 0), turn: Any = (0, 0, 0), **options: float) -> None:
        """See `Guide`."""
        self._world.guide(_numbers(by, 3), _numbers(turn, 3), **options)

    def contact(self, point: Any) -> None:
        """(3,) sensor frame, or None."""
        self._world.hand.contact = None if point is None else _numbers(point, 3)

    def release(self) -> None:
        """Let go."""
        self._world.hand.release()

    def drift(self, **drift: Any) -> None:
        """See `Drift`; nothing switches it off."""
        numbers: dict[str, Any] = {k: float(v) if k == "warm_up_s" else _numbers(v, 6) for k, v in drift.items()}
        self._world.drift = Drift(self._world.now_ns, seed=self._world.seed + 1, **numbers) if drift else None

    def thermal(self, **thermal: Any) -> None:
        """See `Thermal`."""
        numbers: dict[str, Any] = {k: _numbers(v, 6) if k == "gain" else float(v) for k, v in thermal.items()}
        self._world.thermal = Thermal(self._world.now_ns, **numbers)

    def cable(self, **cable: Any) -> None:
        """See `Cable`; nothing cuts it."""
        points = {"anchor", "attached"}
        numbers: dict[str, Any] = {k: _numbers(v, 3) if k in points else float(v) for k, v in cable.items()}
        self._world.cable = Cable(**numbers) if cable else None

    def compliance(self, creep_s: float = 3.0, **given: Any) -> None:
        """See `Compliance`; nothing makes the arm rigid."""
        count = len(self._world.robot.joint_names)
        per_joint = ("joint", "play", "friction", "hardening", "bearing", "slope", "creep")
        unknown = set(given) - {*per_joint, "structure"}
        if unknown:
            raise UsageError(f"no {min(unknown)!r}", where="control", todo=f"one of: structure, {', '.join(per_joint)}")
        numbers = {k: _numbers(v, 6 if k == "structure" else count) for k, v in given.items() if v is not None}
        if creep_s <= 0.0 or any((v < 0.0).any() for k, v in numbers.items() if k != "slope"):
            raise UsageError("must not be negative", where="control", todo="give, friction and widths from 0 on")
        rigid = {"joint": np.zeros(count), "structure": np.zeros(6), "play": np.zeros(count)}
        self._world.compliance = Compliance(**(rigid | numbers), creep_s=float(creep_s)) if numbers else None

    def fault(self, name: str, on: bool = True) -> None:
        """Switch a fault by name."""
        known, stem = self.known_faults(), parse_fault(name)[0]
        if not any(stem == k or stem.startswith(f"{k}.") for k in known):
            raise UsageError(f"no fault {name!r}", where="control", todo=f"one of: {', '.join(sorted(known))}")
        (self._world.faults.add if on else self._world.faults.discard)(name)

    def estop(self, on: bool = True) -> None:
        """Press or release: the emergency-stop input (ELO) of the motor controller."""
        (self._world.faults.add if on else self._world.faults.discard)(_ESTOP)

    def noise(self, scale: float = 1.0, sigma: Any = None) -> None:
        """A factor, or sigmas."""
        self._world.noise_scale = float(scale)
        if sigma is not None:
            self._world.noise_sigma = _numbers(sigma, 6)

    def inertial(self, on: bool = True) -> None:
        """Return whether moving masses read."""
        self._world.inertial = bool(on)

    def power_cycle(self, device: str) -> None:
        """Off and on."""
        cycle = getattr(self._devices.get(device), "power_cycle", None)
        if cycle is None:
            raise UsageError(f"no device {device!r} with a switch", where="control", todo=", ".join(self._devices))
        cycle(self._clock())

    def stop(self) -> None:
        """End the process after this answer."""
        self.stopped = True

    def known_faults(self) -> dict[str, str]:
        """Name and meaning of every fault of every device."""
        out = dict(_MOTOR_FAULTS)
        for device in self._devices.values():
            out |= dict(getattr(device, "FAULTS", {}))
        return out

    def state(self) -> dict[str, Any]:
        """Everything that is true now."""
        world, now = self._world, self._world.now_ns
        q, dq, _ = world.joints(now)
        names = world.robot.joint_names
        return {
            "t_ns": now,
            "seed": world.seed,
            "joints": dict(zip(names, q.tolist(), strict=True)),
            "velocities": dict(zip(names, dq.tolist(), strict=True)),
            "tool": None if world.tool is None else world.tool.name,
            "load": world.load(now).tolist(),
            "sensor_pose": world.sensor_pose(now).tolist(),
            "tip_pose": world.tip_pose(now).tolist(),
            "temperature": world.temperature,
            "hand_idle": world.hand.idle,
            "stalls": self.stalls,
            "faults": sorted(world.faults),
            "known_faults": self.known_faults(),
            "counters": {name: self._counters(name) for name in self._ports},
            "addresses": {name: port.address for name, port in self._ports.items()},
        }

    def _counters(self, name: str) -> dict[str, int]:
        return {**self._ports[name].counters, **getattr(self._devices[name], "counters", {})}


def _numbers(value: Any, count: int) -> Array:
    out = np.asarray(value, dtype=float)
    if out.shape != (count,) or not np.isfinite(out).all():
        raise UsageError(f"{count} finite numbers expected, got {value!r}", where="control", todo="give a plain list")
    return out
