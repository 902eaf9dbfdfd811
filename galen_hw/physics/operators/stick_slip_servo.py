"""Servos that stick against dry friction: the same over a batch of rows and over one row after the other."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from scipy.signal import lfilter

from galen_hw.physics.operators.filters import EVEN, FORGOTTEN, LONG, evenly
from galen_hw.spatial import Array

MANY_SERVOS = 48
"""From which they are walked side by side: a row of arrays costs as much as about so many single numbers."""


@dataclass(frozen=True)
class ServoState:
    """Last time (s) and last output of servos that stick."""

    time: float
    output: Array


def servo(
    time: Array,
    command: Array,
    band: Array,
    constant: Array,
    settling: Array,
    state: ServoState | None,
    *,
    even: bool | None = None,
) -> tuple[Array, ServoState]:
    """Return a servo without integral action against dry friction: T dq/dt = z(c - q), z the dead zone of +- `band`.

    It sticks while the stiffness times c - q cannot overcome the friction, then follows, a friction's width behind. T is its
    damping over its stiffness: play of the command for T = 0, a first-order lag for a band of zero. Friction that is viscous
    at creeping speed, up to its full size at some v, gives way while it sticks: (T + band / v) dq/dt = c - q. Source:
    Armstrong-Helouvry, Dupont, Canudas de Wit 1994, sec. 2 and 4 (friction over speed; stand-off under PD control).

    Args:
        time: (N,) s.
        command: (N, m) c, held over each step.
        band: (m,) friction over stiffness, in the unit of c.
        constant: (m,) T, s.
        settling: (m,) T + band / v > T, s; infinite where it holds for good.
        state: what the last row left; None: the output starts at the first command.
        even: `evenly` of the clock, where it is known.
    """
    before = time[0] if state is None else state.time
    steps = np.maximum(np.diff(np.concatenate([[before], time])), 0.0)
    start = command[0] if state is None else state.output
    if command.shape[1] >= MANY_SERVOS:
        out = _side_by_side(steps, command, band, constant, settling, start)
        return out, ServoState(float(time[-1]), out[-1].copy())
    out = np.empty_like(command, dtype=float)
    # On an even clock every row but the first has the shares of every other; where it starts nothing moves it.
    even = evenly(time) if even is None else even
    each = (x.tolist() for x in (band, constant, settling, start, _breaking(band, constant, settling)))
    for j, (r, lag_j, slow, first, breaks) in enumerate(zip(*each, strict=True)):
        quick, creeping = (-np.expm1(-(steps[[0, -1]] if even else steps) / one) for one in (lag_j, slow))
        servo_j, c = _Servo(r, breaks), np.ascontiguousarray(command[:, j], dtype=float)
        if even:
            at = servo_j.walked(first, quick[:1].tolist(), creeping[:1].tolist(), c[:1].tolist())
            out[0, j] = at[0]
            out[1:, j] = servo_j.followed(at[0], float(quick[1]), float(creeping[1]), c[1:])
        else:
            out[:, j] = servo_j.walked(first, quick.tolist(), creeping.tolist(), c.tolist())
    return out, ServoState(float(time[-1]), out[-1].copy())


def _breaking(band: Array, constant: Array, settling: Array) -> Array:
    """Return the error (m,), in the unit of the command, at which servos break loose; their numbers as of `servo`."""
    gives = np.isfinite(settling)
    known = band * np.where(gives, settling, 1.0)
    return np.asarray(np.divide(known, settling - constant, out=band.astype(float), where=gives))


@dataclass(frozen=True)
class _Servo:
    """One servo: its friction over stiffness, and the error at which it breaks loose."""

    band: float
    breaks: float

    def walked(self, q: float, quick: Iterable[float], creeping: Iterable[float], command: list[float]) -> list[float]:
        """Return outputs row by row from q on; of each row the shares of the error that go while it slips and while it sticks."""
        at, r, breaks = [], self.band, self.breaks
        for share, little, c in zip(quick, creeping, command, strict=False):
            error = c - q
            if error > breaks:
                q += share * (error - r)
            elif error < -breaks:
                q += share * (error + r)
            else:
                q += little * error
            at.append(q)
        return at

    def followed(
        self,
        q: float,
        share: float,
        little: float,
        command: Array,
        *,
        brief: int = 64,
        first_stretch: int = 128,
        longest: int = 8192,
    ) -> Array:
        """Return the outputs (N,) if all rows have the same shares: it slips to one side, or sticks, over many rows at once.

        Args:
            brief: rows of a phase below which it costs less to walk row by row, as what comes next probably
                does too.
            first_stretch: rows that are walked then, at first.
            longest: rows that are walked then, at most.
        """
        count, begun, stretch = len(command), 0, first_stretch
        if count < LONG or not share < 1.0:
            return np.array(self.walked(q, repeat(share), repeat(little), command.tolist()))
        out, loose, stuck = np.empty(count), _Following.of(command, q, share), _Following.of(command, q, little)
        while begun < count:
            error = float(command[begun]) - q
            side = float(error > self.breaks) - float(error < -self.breaks)
            how = loose if side else stuck
            apart = q - float(how.place[begun]) + side * self.band
            end = self._end(how, begun, side, apart)
            out[begun:end] = how.place[begun + 1 : end + 1] - side * self.band
            fading = how.fading[1 : end - begun + 1]
            out[begun : begun + len(fading)] += apart * fading
            if end - begun >= brief:
                stretch = first_stretch
            else:
                start, end = end, min(end + stretch, count)
                walk = self.walked(float(out[start - 1]), repeat(share), repeat(little), command[start:end].tolist())
                out[start:end], stretch = walk, min(2 * stretch, longest)
            begun, q = end, float(out[end - 1])
        return out

    def _end(self, how: "_Following", begun: int, side: float, apart: float, *, chunk: int = 256) -> int:
        """Return the first row behind `begun` at which it no longer slips to this side, or no longer sticks (0).

        Args:
            chunk: rows in which the end is sought at first.
        """
        row, size = begun + 1, chunk
        while row < len(how.ahead):
            error = how.ahead[row : row + size] + side * self.band
            fading = how.fading[row - begun : row - begun + len(error)]
            error[: len(fading)] -= apart * fading
            over = side * error <= self.breaks if side else np.abs(error) > self.breaks
            first = int(over.argmax())
            if over[first]:
                return row + first
            row, size = row + size, 2 * size
        return len(how.ahead)


@dataclass(frozen=True)
class _Following:
    """What goes a share of the error each row, whatever it is: from where it is apart from that by D, D `fading` is left of it.

    Args:
        place: (N + 1,) where it is, its start first; ahead: (N,) the command less the last of these.
        fading: (n,) what is left after so many rows, until it is forgotten.
    """

    place: Array
    ahead: Array
    fading: Array

    @classmethod
    def of(cls, command: Array, q: float, share: float) -> "_Following":
        """Return the output behind a command (N,), from q on."""
        kept, count = 1.0 - share, len(command) + 1
        place = np.full(count, q)
        if share > 0.0:
            place[1:] = lfilter([share], [1.0, -kept], command, zi=[kept * q])[0]
            count = min(count, int(np.log(FORGOTTEN) / np.log(kept)) + 2)
        return cls(place, command - place[:-1], np.power(kept, np.arange(count), dtype=float))


def _side_by_side(steps: Array, command: Array, band: Array, constant: Array, settling: Array, start: Array) -> Array:
    """Return the outputs (N, m) of many servos, a row of all at a time; `steps` (N,) s, the rest as of `servo`, `start` (m,)."""
    out, q, breaks = np.empty_like(command, dtype=float), start.astype(float), _breaking(band, constant, settling)
    last, share, little = -1.0, np.empty(0), np.empty(0)
    error, slips, moves, loose = np.empty_like(q), np.empty_like(q), np.empty_like(q), np.empty(len(q), dtype=bool)
    for i, step in enumerate(steps.tolist()):
        if abs(step - last) > EVEN * step:  # not where a clock is even but for rounding
            last, share, little = step, -np.expm1(-step / constant), -np.expm1(-step / settling)
        np.subtract(command[i], q, out=error)
        np.copysign(band, error, out=slips)
        np.subtract(error, slips, out=slips)
        np.multiply(share, slips, out=slips)
        np.multiply(little, error, out=moves)
        np.greater(np.abs(error, out=error), breaks, out=loose)
        np.copyto(moves, slips, where=loose)
        q = np.add(q, moves, out=out[i])
    return out
