"""The shape of a service: handed messages, returns messages; pure, so that it can be replayed bit for bit.

A service survives any well-typed message: NaN, gaps, repeats, time going back.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

from pydantic import BaseModel

from galen_hw.clock import TimeBase
from galen_hw.kinematics import Robot
from galen_hw.messages import Message, Reply, Request

Output: TypeAlias = tuple[str, Message] | Request | Reply
"""A service's output: a message with its topic, a request to a device, or the answer to a request."""


@dataclass(frozen=True, slots=True)
class ServiceContext:
    """What every service is given beside its settings.

    Args:
        robot: the configured robot (joint names, limits, kinematics).
        time_base: turns `t_ns` into `timestamp`.
        state_dir: the state directory; tools and calibrations live below it (`ToolStore(context.state_dir)`).
        identity: of the configured hardware (robot and devices), for `snapshot` and `restore`.
        sensor, motors, tracker: names of these devices, for the `target` of requests; empty where not configured.
        virtual: the devices are virtual; None where there are none (a replay).
    """

    robot: Robot
    time_base: TimeBase
    state_dir: Path
    identity: str = ""
    sensor: str = "ft"
    motors: str = "motors"
    tracker: str = "tracker"
    virtual: bool | None = False


class Service(ABC):
    """One service of the configuration.

    Args:
        name: in the configuration; the `source` of its messages and the `target` of its requests.
        settings: an instance of the class' own `Settings`.
        context: robot, time base, directories and identity.

    `patience_s`: how long messages from other processes may wait before it is handed them, several at once: a process
    that is woken for every sample at 1 kHz costs the others their latency. 0 for at once.
    `takes_old`: it is handed what is older than the topic's limit as well (a recorder: it was on time when published).
    """

    Settings: ClassVar[type[BaseModel]]
    consumes: ClassVar[tuple[str, ...]]
    produces: ClassVar[tuple[str, ...]]
    keep_now: bool = False
    """Set by a service whose snapshot has become worth writing down without a command; taken back by who writes it."""
    patience_s: ClassVar[float] = 0.005
    takes_old: ClassVar[bool] = False
    name: str

    @abstractmethod
    def __init__(self, name: str, settings: Any, context: ServiceContext) -> None: ...

    @property
    def wants(self) -> tuple[str, ...]:
        """Topics that it takes now: fewer than `consumes` while it has nothing to do with the others.

        At 1 kHz each process that is handed a stream takes time from all others, whatever it then does with it. What is
        wanted anew comes some hundredths of a second later. (Within its own process a service is handed all it consumes.)
        """
        return self.consumes

    @abstractmethod
    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Take one message of a consumed topic."""

    @abstractmethod
    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Carry out a command; outputs include its `Reply` unless it comes later.

        Raises:
            CommandRejectedError: not now, not so, or not known; nothing has changed.
        """

    def tick(self, now_ns: int) -> list[Output]:
        """What time alone brings (time-outs, status), called at least ten times a second."""
        del now_ns
        return []

    def reply(self, reply: Reply, now_ns: int) -> list[Output]:
        """Take the answer to a request that this service made."""
        del reply, now_ns
        return []

    def end(self, now_ns: int) -> list[Output]:
        """What must be said and ordered before the process ends; `close` follows."""
        del now_ns
        return []

    @abstractmethod
    def snapshot(self) -> dict[str, Any]:
        """State worth keeping over a restart, with a version and the identity of the hardware it belongs to."""

    @abstractmethod
    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back; False (and a clean start) when version or identity do not match."""

    def close(self) -> None:  # noqa: B027 - most have nothing to finish
        """Finish what must not stay half done (an open file); the last call."""
