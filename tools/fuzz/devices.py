"""Foreign bytes on the wire of a device that runs: its virtual peer answers it, and between the answers there is noise."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.drivers.device import CanFrame, Device
from galen_hw.drivers.galil_dmc import GalilDmc
from galen_hw.drivers.iit_strain import IitStrain
from galen_hw.drivers.ndi_tracker import NdiTracker
from galen_hw.drivers.robotous_rft import RobotousRft
from galen_hw.drivers.virtual.ati_netcanoem import AtiSettings, VirtualAtiNetcanoem
from galen_hw.drivers.virtual.galil_dmc import VirtualGalilDmc
from galen_hw.drivers.virtual.iit_strain import StrainSettings, VirtualIitStrain
from galen_hw.drivers.virtual.robotous_rft import RftSettings, VirtualRobotousRft
from galen_hw.drivers.virtual.world import World

STEP_NS: Final = 200_000
STEPS: Final = 4
"""Turns of the loop after each input, in which the peer may answer."""
START_STEPS: Final = 60_000


@dataclass
class Noisy:
    """A device that is ready, and its virtual peer (None: it hears noise alone).

    What a noise has done to it stays for the next one, as it would on a socket.
    """

    device: Device[Any]
    peer: Any
    now_ns: int = NS_PER_S
    heard: int = field(default=0)

    def __post_init__(self) -> None:
        self.device.start(self.now_ns)
        for _ in range(START_STEPS if self.peer is not None else STEPS):
            if self.device.ready:
                break
            self.turn()

    def turn(self) -> None:
        """One turn of the loop."""
        wires, _ = self.device.poll(self.now_ns)
        if self.peer is not None:
            for wire in wires:
                self.peer.feed(wire, self.now_ns)
            for wire in self.peer.poll(self.now_ns):
                self.device.feed(wire, self.now_ns)
        self.now_ns += STEP_NS

    def take(self, wires: list[Any]) -> None:
        """Noise, then a few turns of the loop."""
        for wire in wires:
            self.heard += 1
            self.device.feed(wire, self.now_ns)
        for _ in range(STEPS):
            self.turn()


def frames_of(data: bytes) -> list[CanFrame]:
    """CAN frames: a byte of length, two of the identifier, the data; again and again."""
    frames, place = [], 0
    while place + 3 <= len(data):
        length, end = data[place] % 9, place + 3 + data[place] % 9
        frames.append(CanFrame(int.from_bytes(data[place + 1 : place + 3]) & 0x7FF, data[place + 3 : end]))
        place = max(end, place + 3 + length)
    return frames


def chunks_of(data: bytes) -> list[bytes]:
    """The bytes of a line, cut by their own first byte."""
    size = 1 + (data[0] if data else 0)
    return [data[n : n + size] for n in range(1, len(data), size)]


def ati() -> Callable[[bytes], None]:
    """An ATI sensor that samples."""
    settings = AtiNetcanoem.Settings(rate_hz=1000.0)
    noisy = Noisy(
        AtiNetcanoem("ft", settings, TimeBase()), VirtualAtiNetcanoem(AtiSettings.model_validate({}), World())
    )
    return lambda data: noisy.take(frames_of(data))


def robotous() -> Callable[[bytes], None]:
    """A Robotous sensor that streams."""
    device = RobotousRft("ft", RobotousRft.Settings(), TimeBase())
    noisy = Noisy(device, VirtualRobotousRft(RftSettings.model_validate({}), World()))
    return lambda data: noisy.take(frames_of(data))


def iit() -> Callable[[bytes], None]:
    """Make an IIT sensor that streams."""
    device = IitStrain("ft", IitStrain.Settings(), TimeBase())
    noisy = Noisy(device, VirtualIitStrain(StrainSettings.model_validate({}), World()))
    return lambda data: noisy.take(frames_of(data))


def galil() -> Callable[[bytes], None]:
    """A controller that is polled."""
    noisy = Noisy(
        GalilDmc("motors", GalilDmc.Settings.model_validate({}), TimeBase()),
        VirtualGalilDmc(VirtualGalilDmc.Settings.model_validate({}), World()),
    )
    return lambda data: noisy.take(chunks_of(data))


def ndi() -> Callable[[bytes], None]:
    """A tracker of which nothing but noise is heard, from its start on: it begins again and again."""
    noisy = Noisy(NdiTracker("tracker", NdiTracker.Settings(), TimeBase()), None)
    return lambda data: noisy.take(chunks_of(data))
