"""How a tracker is brought from power-up to tracking, as a generator that yields steps and is sent replies."""

from collections.abc import Generator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TypeAlias

from galen_hw.drivers.ndi_tracker.codec import BAUD_CODES, ERRORS, handles, rom_writes
from galen_hw.drivers.ndi_tracker.settings import MarkerSettings, Role
from galen_hw.drivers.serial_line import LineChange

POWER_UP_BAUD: Final = 9600
_SET_ROM: Final = "set rom_file in settings.markers of the tracker to the marker body's tool definition"
_BREAK_NS: Final = 500_000_000
_SWITCH_NS: Final = 200_000_000
_ENABLED: Final = 0x20
_WIRELESS: Final = "PHRQ:*********1****"


class NdiError(Exception):
    """The tracker answered ERRORnn."""

    def __init__(self, text: str, code: int) -> None:
        keyword = text.partition(":")[0]
        super().__init__(f"{keyword} refused with error {code:02X}: {ERRORS.get(code, 'unknown')}")
        self.code = code


class NdiSilentError(Exception):
    """No reply, or none that could be read."""


class NdiUnsettledError(NdiSilentError):
    """RESET, or noise, came in place of the reply: a tracker that was just switched on, perhaps at this very rate."""


class NdiSetupError(Exception):
    """The tracker works, but not with what the configuration asks for."""

    def __init__(self, what: str, todo: str) -> None:
        super().__init__(what)
        self.todo = todo


@dataclass(frozen=True, slots=True)
class Ask:
    """Send a command and await its reply; `timeout_ns` 0 means the setting's."""

    text: str
    timeout_ns: int = 0


@dataclass(frozen=True, slots=True)
class Hear:
    """Await a line that comes by itself."""

    timeout_ns: int


@dataclass(frozen=True, slots=True)
class Pause:
    """Let time pass; what comes meanwhile is thrown away."""

    duration_ns: int


Step: TypeAlias = Ask | Hear | Pause | LineChange
Script: TypeAlias = Generator[Step, str, dict[str, Role]]


def connect(markers: Mapping[Role, MarkerSettings], baud_rate: int | None, init_ns: int, reset_ns: int) -> Script:
    """From any state to tracking; the handles and whose they are.

    Args:
        markers: what to track.
        baud_rate: final rate of a serial line; None on a socket, where rate and break mean nothing.
        init_ns, reset_ns: longest wait for INIT, and for RESET after a break.

    Raises:
        NdiError, NdiSilentError, NdiSetupError: it cannot be done; why.
    """
    if baud_rate is None:
        if not (yield from _init(init_ns)):
            raise NdiSilentError
    else:
        yield from _reach(baud_rate, init_ns, reset_ns)
    for handle in handles((yield Ask("PHSR:01"))):
        yield Ask(f"PHF:{handle}")
    found = yield from _allocate(markers)
    yield from _initialise(found)
    for handle in handles((yield Ask("PHSR:03"))):
        yield Ask(f"PENA:{handle}D")
    found |= yield from _known_bodies(markers, found)
    states = handles((yield Ask("PHSR:00")))
    for handle, role in found.items():
        if not states.get(handle, 0) & _ENABLED:
            raise NdiSetupError(f"{role}: handle {handle} cannot be enabled", _SET_ROM)
    yield Ask("TSTART:", init_ns)
    return found


def _reach(baud_rate: int, init_ns: int, reset_ns: int) -> Generator[Step, str, None]:
    """INIT at the power-up rate, at the final one (an earlier session left it there), or after a break; then COMM."""
    for rate in dict.fromkeys((POWER_UP_BAUD, baud_rate)):
        yield LineChange(baud_rate=rate)
        if (yield from _init(init_ns)):
            break
    else:
        rate = POWER_UP_BAUD
        yield LineChange(baud_rate=rate, break_on=True)
        yield Pause(_BREAK_NS)
        yield LineChange(break_on=False)
        with suppress(NdiSilentError):  # a line without a break (a pseudo terminal) may still have come to itself
            yield Hear(reset_ns)
        if not (yield from _init(init_ns)):
            raise NdiSilentError
    if rate != baud_rate:
        yield Ask(f"COMM:{BAUD_CODES[baud_rate]}0000")
        yield LineChange(baud_rate=baud_rate)
        yield Pause(_SWITCH_NS)


def _init(init_ns: int) -> Generator[Step, str, bool]:
    """Return whether INIT is answered with OKAY.

    Tracking left on by an earlier session is ended first; one that was just switched on is asked once more.
    """
    for _ in range(3):
        try:
            return (yield Ask("INIT:", init_ns)) == "OKAY"
        except NdiUnsettledError:
            yield Pause(_SWITCH_NS)  # a late OKAY must not be taken for the next reply
        except NdiSilentError:
            return False
        except NdiError:
            try:
                yield Ask("TSTOP:")
            except NdiError:
                pass
            except NdiSilentError:
                return False
    return False


def _allocate(markers: Mapping[Role, MarkerSettings]) -> Generator[Step, str, dict[str, Role]]:
    """A handle with its tool definition for each wireless body; the others must be plugged in.

    Raises:
        NdiSetupError: a body without a definition, and nothing is plugged in that it could be: a tracker tells passive
            bodies by their geometry, which only the definition holds.
    """
    found: dict[str, Role] = {}
    plugged = len(handles((yield Ask("PHSR:00"))))
    for role, marker in markers.items():
        named = marker.handle is not None or marker.serial_number is not None
        if not marker.rom and (named or plugged):
            plugged = max(0, plugged - 1)
            continue
        if not marker.rom:
            raise NdiSetupError(f"{role}: a wireless marker body needs its tool definition (.rom)", _SET_ROM)
        handle = yield Ask(_WIRELESS)
        for write in rom_writes(handle, marker.rom):
            yield Ask(write)
        found[handle] = role
    return found


def _initialise(found: Mapping[str, Role]) -> Generator[Step, str, None]:
    """PINIT for all that need it; a body that nobody asked for and that fails is freed."""
    for _ in range(3):  # initialising one may bring up others
        waiting = handles((yield Ask("PHSR:02")))
        if not waiting:
            return
        for handle in waiting:
            try:
                yield Ask(f"PINIT:{handle}")
            except NdiError as error:
                if handle in found:
                    raise NdiSetupError(f"{found[handle]}: {error}", _SET_ROM) from None
                yield Ask(f"PHF:{handle}")


def _known_bodies(
    markers: Mapping[Role, MarkerSettings], found: Mapping[str, Role]
) -> Generator[Step, str, dict[str, Role]]:
    """The handles of the bodies without a tool definition: by handle, by serial number, or what is left in order."""
    wanted = {role: marker for role, marker in markers.items() if role not in found.values()}
    if not wanted:
        return {}
    present = [handle for handle in handles((yield Ask("PHSR:00"))) if handle not in found]
    serials: dict[str, str] = {}
    for handle in present:
        serials[handle] = (yield Ask(f"PHINF:{handle}0021"))[23:31].strip()
    taken: dict[str, Role] = {}
    named = {role: m for role, m in wanted.items() if m.handle or m.serial_number}
    for role, marker in {**named, **wanted}.items():
        fits = [
            handle
            for handle in present
            if handle not in taken
            and marker.handle in (None, handle)
            and marker.serial_number in (None, serials[handle])
        ]
        if not fits:
            there = ", ".join(f"{handle} ({serial})" for handle, serial in serials.items()) or "none"
            what = f"{role}: no such marker body, the tracker has {there}"
            raise NdiSetupError(what, "set rom_file of a wireless body, or plug the wired one in")
        taken[fits[0]] = role
    return taken
