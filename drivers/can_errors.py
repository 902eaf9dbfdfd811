"""What can go wrong with a CAN wire, in words for people, and the counting of error frames."""

import errno
from typing import Final

from galen_hw.errors import HardwareError

ERROR_COUNTERS: Final = (
    "error_frames",
    "bus_off",
    "error_passive",
    "overruns",
    "no_acknowledge",
    "restarted",
    "rejected",
)
"""Counted: all error frames, and what they say happened; `rejected` are commands an slcan adapter refused."""

BUS_OFF_TODO: Final = "check cable, termination and bit rate; it comes back by itself where restart-ms is set"
_CONTROLLER, _ACKNOWLEDGE, _BUS_OFF, _RESTARTED = 0x004, 0x020, 0x040, 0x100
_OVERFLOW, _PASSIVE = 0x03, 0x30


def count_error_frame(kinds: int, data: bytes, counters: dict[str, int]) -> None:
    """Count an error frame by its class (linux/can/error.h), which is its identifier."""
    detail = data[1] if len(data) > 1 else 0
    counters["error_frames"] += 1
    counters["bus_off"] += bool(kinds & _BUS_OFF)
    counters["no_acknowledge"] += bool(kinds & _ACKNOWLEDGE)
    counters["restarted"] += bool(kinds & _RESTARTED)
    counters["error_passive"] += bool(kinds & _CONTROLLER and detail & _PASSIVE)
    counters["overruns"] += bool(kinds & _CONTROLLER and detail & _OVERFLOW)


def news_of(kinds: int) -> list[tuple[str, str]]:
    """What an error frame says that its user must know, and what to do: what, todo."""
    if kinds & _BUS_OFF:
        return [("the CAN controller is bus-off: nothing is sent or heard", BUS_OFF_TODO)]
    if kinds & _RESTARTED:
        return [("the CAN controller was started again after bus-off", "look at the cable if this comes again")]
    return []


def is_full(error: Exception) -> bool:
    """The interface has no room for a frame (nobody acknowledges), which is no reason to open it again."""
    return _errno(error) == errno.ENOBUFS or "full" in str(error).lower()


def explain(interface: str, channel: str, error: Exception) -> HardwareError:
    """Why a wire could not be opened: what, where, what to do."""
    number = _errno(error)
    where = f"{interface}:{channel}"
    if interface == "socketcan" and number in _SOCKETCAN:
        what, todo = _SOCKETCAN[number]
    elif number in _COMMON or "lock" in str(error):
        what, todo = _COMMON.get(number, _COMMON[errno.EBUSY])
    elif "ioctl" in str(error):
        what, todo = "this is not a serial port", "give the port of the CAN adapter, e.g. /dev/ttyACM0"
    else:
        what, todo = f"cannot be opened ({error})", "check interface, channel and options in the configuration"
    return HardwareError(what, where=where, todo=todo.format(channel=channel))


def _errno(error: BaseException) -> int:
    """The system's error number behind an exception of python-can or pyserial, 0 when there is none."""
    seen: BaseException | None = error
    while seen is not None:
        for number in (getattr(seen, "errno", None), getattr(seen, "error_code", None)):
            if isinstance(number, int) and number != 0:
                return number
        seen = seen.__cause__ or seen.__context__
    return 0


_BUSY = ("another program has it open", "stop that program, or is galen-hw running already?")
_SOCKETCAN: Final = {
    errno.EAFNOSUPPORT: (
        "this machine's kernel has no SocketCAN",
        "use interface slcan, or load the modules can and can_raw",
    ),
    errno.ENODEV: ("no such CAN interface", "`ip -brief link` shows those there are; check the adapter"),
    errno.ENETDOWN: ("the interface is down", "ip link set {channel} up type can bitrate 1000000"),
    errno.EPERM: ("no permission to open CAN sockets", "run it as a user or service that may"),
}
_COMMON: Final = {
    errno.ENOENT: ("no such port", "check that the adapter is plugged in and how it is named"),
    errno.ENXIO: ("no such port", "check that the adapter is plugged in and how it is named"),
    errno.EACCES: ("no permission to open it", "add the user to the port's group (dialout), or install the udev rules"),
    errno.EPERM: ("no permission to open it", "add the user to the port's group (dialout), or install the udev rules"),
    errno.EBUSY: _BUSY,
    errno.EAGAIN: _BUSY,
    errno.ECONNREFUSED: ("nobody listens there", "start the server, or check host and port"),
    errno.ETIMEDOUT: ("no answer from there", "check host and port"),
    errno.EHOSTUNREACH: ("no way to that host", "check host and network"),
    errno.ENETUNREACH: ("no way to that network", "check the address and the network"),
    errno.EADDRNOTAVAIL: ("this machine has no network for that address", "check the multicast address"),
    -2: ("not an address", "give a multicast address, e.g. 239.74.163.2, or a host that is known"),
}
