"""A host at the other end of the virtual controller, with its own clock: no sleeps."""

from dataclasses import dataclass, field

from galen_hw.drivers.virtual.galil_dmc import VirtualGalilDmc
from galen_hw.drivers.virtual.world import World

MS = 1_000_000


@dataclass
class Host:
    """Asks, lets time pass, and collects what has come."""

    settings: dict = field(default_factory=lambda: {"baud_rate": 0, "echo": False})
    world: World = field(default_factory=World)
    now_ns: int = 0

    def __post_init__(self) -> None:
        self.device = VirtualGalilDmc(VirtualGalilDmc.Settings(**self.settings), self.world)

    def ask(self, line: str, ms: float = 2.0) -> str:
        return self.ask_raw(line, ms).decode("latin-1")

    def ask_raw(self, line: str, ms: float = 2.0) -> bytes:
        self.device.feed(line.encode("latin-1") + b"\r", self.now_ns)
        return self.wait(ms)

    def wait(self, ms: float) -> bytes:
        self.now_ns += round(ms * MS)
        return b"".join(self.device.poll(self.now_ns))

    def numbers(self, line: str) -> list[float]:
        answer = self.ask(line)
        assert answer.endswith("\r\n:"), answer
        return [float(x) for x in answer[:-3].replace(",", " ").split()]

    def until_still(self, axis: str = "A", at_most_s: float = 60.0) -> float:
        """Seconds until _BG is 0."""
        start = self.now_ns
        while self.numbers(f"MG _BG{axis}") != [0.0]:
            self.wait(5.0)
            assert self.now_ns - start < at_most_s * 1e9
        return (self.now_ns - start) * 1e-9
