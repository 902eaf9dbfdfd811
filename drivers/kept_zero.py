"""A sensor's zero that outlives the process which made it: what is written down of it, and when it is taken up again.

The process writes it down when it was made and every few seconds while the sensor answers (`seen_ns`). The next one
takes it up when the same sensor answers that was seen shortly before: as after a silence of the wire within one process.
"""

from dataclasses import dataclass
from typing import Any

import msgspec

from galen_hw.clock import NS_PER_S


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """What is written down.

    Args:
        serial_number: of the sensor.
        zeroings: as in `WrenchRaw`, above 0; zeroed_ns: when (CLOCK_MONOTONIC), for people.
        values: what the host subtracts; empty where the sensor does so itself.
        seen_ns: when the sensor gave samples last, CLOCK_MONOTONIC.
        tool: what hung on the sensor when it was written, as far as is known; empty for none.
    """

    serial_number: str
    zeroings: int
    zeroed_ns: int
    seen_ns: int
    values: list[float] = []
    tool: str = ""


@dataclass(slots=True)
class KeptZero:
    """The zero of one device, on its way to the next process.

    Args:
        longest_away_s: beyond that the sensor may have been switched off, warmed up or exchanged; 0: never taken up.
    """

    longest_away_s: float
    _offered: dict[str, Any] | None = None
    _obstacle: str = ""
    _made: tuple[int, int] = (0, 0)
    _seen_ns: int = 0
    _story: str = ""

    def offer(self, record: dict[str, Any], obstacle: str) -> None:
        """A record of an earlier process, to be decided on when the sensor has said who it is."""
        self._offered, self._obstacle = record, obstacle

    def record(self, serial: str, zeroings: int, values: list[float], now_ns: int, *, seen: bool) -> dict[str, Any]:
        """What to write down now: empty without a zero; what was offered as long as that is not decided."""
        if self._offered is not None:
            return {} if self._obstacle else self._offered
        if not zeroings:
            return {}
        if self._made[0] != zeroings:
            self._made, self._seen_ns, self._story = (zeroings, now_ns), now_ns, ""
        if seen:
            self._seen_ns = now_ns
        kept = Kept(
            serial_number=serial, zeroings=zeroings, zeroed_ns=self._made[1], seen_ns=self._seen_ns, values=values
        )
        return msgspec.to_builtins(kept)  # type: ignore[no-any-return]

    def story(self, zeroings: int) -> str:
        """What a zero that was taken up is, for people; empty for one of this process' own."""
        return self._story if zeroings and zeroings == self._made[0] else ""

    def decide(self, serial: str, count: int, now_ns: int) -> tuple[Kept | None, str]:
        """The zero to take up for the sensor that answers, or None and why not (empty if there was none).

        Args:
            count: of the values that there must be.
        """
        record, self._offered = self._offered, None
        if record is None:
            return None, ""
        try:
            kept = msgspec.convert(record, Kept)
        except msgspec.ValidationError as error:
            return None, self._obstacle or f"what was kept is damaged ({error})"
        if why := self._obstacle or self._against(kept, serial, count, now_ns):
            return None, why
        self._made, self._seen_ns = (kept.zeroings, kept.zeroed_ns), now_ns
        age_s = (now_ns - kept.zeroed_ns) / NS_PER_S
        self._story = f"restored after a restart, {age_s:.0f} s old, kept with {kept.tool or 'no tool'} in hand"
        return kept, ""

    def _against(self, kept: Kept, serial: str, count: int, now_ns: int) -> str:
        """What speaks against a zero for this sensor now."""
        away_s = (now_ns - kept.seen_ns) / NS_PER_S
        if kept.serial_number != serial:
            return f"it is that of sensor {kept.serial_number}, this is {serial}"
        if not 0.0 <= away_s <= self.longest_away_s:
            return f"the sensor was out of sight for {away_s:.0f} s and may have been off"
        if len(kept.values) != count or kept.zeroings < 1 or kept.zeroed_ns > now_ns:
            return "what was kept is damaged"
        return ""
