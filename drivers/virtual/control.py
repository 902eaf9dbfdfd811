"""The control socket of the virtual robot: what a test or a demonstration does to the world, from another process."""

from pathlib import Path
from typing import Any, Self

import msgspec
import zmq

from galen_hw.errors import HardwareError, UsageError

CONTROL_NAME = "control"


class VirtualControl:
    """Client of a running virtual robot; every method returns when the world has changed.

    Forces are in N, torques in N m, lengths in m, in base axes unless said otherwise.

    Args:
        folder: the DIR of `galen-hw virtual --dir DIR`.
        timeout_s: to wait for each answer.
    """

    def __init__(self, folder: Path | str, timeout_s: float = 5.0) -> None:
        self._path = Path(folder) / CONTROL_NAME
        self._timeout_s = timeout_s
        self._socket: zmq.Socket[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def call(self, do: str, **args: Any) -> dict[str, Any]:
        """Send one request; its result.

        Raises:
            HardwareError: nobody answers.
            UsageError: the virtual robot refuses it.
        """
        if self._socket is None:
            self._socket = zmq.Context.instance().socket(zmq.REQ)
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.connect(f"ipc://{self._path}")
        self._socket.send(msgspec.msgpack.encode({"do": do, **args}))
        if not self._socket.poll(round(self._timeout_s * 1000)):
            self.close()
            raise HardwareError("no answer", where=str(self._path), todo="is `galen-hw virtual` running there?")
        reply = msgspec.msgpack.decode(self._socket.recv())
        if "error" in reply:
            raise UsageError(reply["error"])
        return dict(reply["result"])

    def close(self) -> None:
        """Close the socket; it opens again with the next call."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def attach_tool(self, tool: str | dict[str, Any] | None) -> None:
        """Put a tool in the holder: its name, {mass, com, tip, inertia}, or None to take it away."""
        self.call("attach_tool", tool=tool)

    def push(self, **push: Any) -> None:
        """force=[x, y, z], torque=[x, y, z], seconds=1.0, rise_s=0.0, at the point of contact."""
        self.call("push", **push)

    def guide(self, **guide: Any) -> None:
        """by=[x, y, z], turn=[x, y, z] (rotation vector, rad), move_s, seconds, stiffness, damping, ... (`Guide`)."""
        self.call("guide", **guide)

    def contact(self, point: list[float] | None) -> None:
        """Where the hand touches, sensor frame; None is the tool's tip."""
        self.call("contact", point=point)

    def release(self) -> None:
        """The hand lets go of everything."""
        self.call("release")

    def drift(self, **drift: Any) -> None:
        """rate, warm_up, walk (each [6], sensor frame), warm_up_s; nothing at all switches it off."""
        self.call("drift", **drift)

    def thermal(self, **thermal: Any) -> None:
        """start_c, rate (K/s), swing_c, period_s, gain [6] (N/K, N m/K, sensor frame)."""
        self.call("thermal", **thermal)

    def cable(self, **cable: Any) -> None:
        """Anchor [3] (base), attached [3] (sensor frame), stiffness, rest_length, friction, slip; nothing: cut it."""
        self.call("cable", **cable)

    def compliance(self, **compliance: Any) -> None:
        """Joint, play, friction, hardening, bearing, slope, creep [n each], creep_s, structure [6]; nothing: rigid."""
        self.call("compliance", **compliance)

    def fault(self, name: str, on: bool = True) -> None:
        """Switch a fault on or off by name, e.g. "ft.lost_second@10"; `state()["known_faults"]` lists them."""
        self.call("fault", name=name, on=on)

    def estop(self, on: bool = True) -> None:
        """Press or release the emergency stop."""
        self.call("estop", on=on)

    def noise(self, scale: float = 1.0, sigma: list[float] | None = None) -> None:
        """Sensor noise: a factor, or one sigma of each axis."""
        self.call("noise", scale=scale, sigma=sigma)

    def power_cycle(self, device: str = "can0") -> None:
        """Switch a device off and on."""
        self.call("power_cycle", device=device)

    def state(self) -> dict[str, Any]:
        """What is really there: joints, tool, true load and poses, faults, counters, addresses."""
        return self.call("state")

    def stop(self) -> None:
        """End the virtual robot."""
        self.call("stop")
