"""What the ATI board's status word means for the samples, decided bit by bit.

A published log of a good sensor carries 0x4000 in every sample: bit 14 (bus error) set, the summary bit 15 clear. So
the word is never compared with zero, bit 15 never decides, and bit 14 is reported once it has stayed, but neither makes
data invalid nor resets the board: a reset drops the selected calibration, and a bit that sticks would do so again and
again.
"""

from dataclasses import dataclass, field
from typing import Final

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.ati_netcanoem.codec import (
    BUS_ERROR_MASK,
    CRITICAL_MASK,
    DEFAULTS_MASK,
    WATCHDOG_MASK,
    status_texts,
)

_TODO_CRITICAL: Final = "do not use the data; see the sensor's manual"
_TODO_DEFAULTS: Final = "store base id and bit rate in the board again"
_TODO_BUS: Final = "check cable and termination of the CAN bus"


@dataclass(slots=True)
class StatusWord:
    """Follows the status word of one board since its start.

    Args:
        bus_error_s: how long bit 14 must stay before it is worth a word.
    """

    bus_error_s: float
    word: int | None = None
    critical: bool = False
    news: list[tuple[str, str, str]] = field(default_factory=list)
    _bus_error_since_ns: int | None = None

    def take(self, word: int, t_ns: int) -> bool:
        """Take a word that differs from the last; true when the board was reset behind our back.

        `news` then holds the faults it brings: kind, what, what to do.
        """
        old, self.word = self.word, word
        self.news = []
        self.critical = bool(word & CRITICAL_MASK)
        if self.critical:
            texts = "; ".join(status_texts(word & CRITICAL_MASK))
            self.news.append((texts, f"{texts} (status 0x{word:04X})", _TODO_CRITICAL))
        if word & ~(old or 0) & DEFAULTS_MASK:
            texts = status_texts(DEFAULTS_MASK)[0]
            self.news.append(("defaults", texts, _TODO_DEFAULTS))
        if not word & BUS_ERROR_MASK:
            self._bus_error_since_ns = None
        elif self._bus_error_since_ns is None:
            self._bus_error_since_ns = t_ns
        # Set from the start, the watchdog bit tells of the past; when it appears, the selection is lost.
        restarted = old is not None and bool(word & ~old & WATCHDOG_MASK)
        if restarted:
            self.critical = True
            self.news.append(
                ("watchdog", "the board was reset by its watchdog and is started again", "check its supply")
            )
        return restarted

    def state(self, now_ns: int) -> tuple[str, str, str]:
        """Return state, detail and what to do, for the status message."""
        word = self.word or 0
        if self.critical:
            return "fault", "; ".join(status_texts(word & CRITICAL_MASK)), _TODO_CRITICAL
        texts = status_texts(word & DEFAULTS_MASK)
        todos = [_TODO_DEFAULTS] if texts else []
        if self._bus_error_since_ns is not None and now_ns - self._bus_error_since_ns >= self.bus_error_s * NS_PER_S:
            texts += status_texts(BUS_ERROR_MASK)
            todos.append(_TODO_BUS)
        return ("degraded", "; ".join(texts), "; ".join(todos)) if texts else ("ready", "", "")
