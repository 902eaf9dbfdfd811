"""Effects of the clock: one stream late against the other, and slow filters."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.clocks import Filter, Shift
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.parameters import Parameter, Searched, log_grid, spacing
from galen_hw.physics.effects.traits import Averages
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import Beginning, Lagging
from galen_hw.spatial import Array


@dataclass(frozen=True)
class TimeDelay(Shift):
    """One stream is late: y(t) = w(t - d), one number for all channels; its slope at zero is -dw/dt.

    `joint` restricts it to one joint's reading; `between`: see `BETWEEN`; steps are lines to it. Visible where the channels move.
    Confused with lag (the same to first order), with viscous friction and compliance where load follows speed.
    """

    KEY = "time_delay"
    SAYS = "the recording is late against the simulation"
    KNOWN_BY = "it is proportional to the rate of change and the same everywhere"
    CONFIRMED_BY = "move one joint at two speeds, with quick starts"
    HEAD = ("delay",)
    ALIKE: ClassVar = {
        "lag": "for motion this slow a delay and a first-order lag are the same",
        "friction": "for motion at nearly one speed a delay shifts as friction does",
    }
    COMPLEXITY = 0
    joint: str = ""
    between: str = "lines"

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield one for the stream; for joints' own readings one a joint too."""
        if not scene.clock or not np.any(scene.simulated_rate):
            return
        yield cls()
        if scene.observations.predict == "position" and len(scene.channels) > 1:
            yield from (cls(joint_of(name)) for name in scene.channels)

    def lagging(
        self, constant: float, shortest: float, damping: float | None = None, speed_limit: float | None = None
    ) -> "Lag":
        """Return what answers slowly where this one is late, all of it."""
        plain = Lag(constant, self.joint, shortest, whole=True, between=self.between)
        return replace(plain, damping=damping, speed_limit=speed_limit)

    def partners(self, scene: Scene) -> Iterator["Lag"]:
        """Yield servos with a speed limit: beside a delay that may be all that there is of a lag."""
        shortest, several = 0.5 * spacing(scene), len(scene.channels) > 1
        for c in self.places(scene):
            joint = joint_of(scene.channels[c]) if several else ""
            yield from Lag(shortest, joint, shortest, between=self.between).limited(scene)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the delay, positive when the recording is late against the simulation."""
        return (Parameter("delay", "s"),)

    def columns(self, scene: Scene) -> Columns:
        """Return minus the simulated rate."""
        places = self.places(scene)
        return Columns(places, -scene.simulated_rate[:, places, None])

    def bends(self, scene: Scene, theta: Array) -> bool:
        """Return True: a shift is not its slope."""
        return True

    def beginning(self, scene: Scene, theta: Array, others: Sequence[Effect]) -> Beginning:
        """Return as many seconds as it is late, or at the end as it is early."""
        late = float(theta[0])
        return Beginning(max(late, 0.0), max(-late, 0.0))

    def exact(self, scene: Scene, theta: Array) -> Array | None:
        """Return the simulated channels shifted, less themselves."""
        places, out = self.places(scene), np.zeros_like(scene.simulated)
        mine = scene.simulated[:, places]
        out[:, places] = self.retimed(scene, mine, theta) - mine
        return out

    def retimed(self, scene: Scene, x: Array, theta: Array) -> Array:
        """Return signals (N, m) as this stream delivers them."""
        return scene.delay("delay", x, float(theta[0]), bowed=self.bowed)

    def delivered_on(self, rows: Averages, scene: Scene, columns: Columns, theta: Array) -> Columns:
        """Return the averages of what is late, which are late averages."""
        if not columns.count:
            return super().delivered_on(rows, scene, columns, theta)
        places, late = self.places(scene), float(theta[0])
        mine = [i for i, c in enumerate(columns.channels) if c in places]
        if not mine:
            return Columns(columns.channels, rows.average(columns.values))
        if len(mine) == len(columns.channels):
            return Columns(columns.channels, rows.late(columns.values, late, bowed=self.bowed))
        out = np.empty((len(rows.simulated), *columns.values.shape[1:]))
        rest = [i for i in range(len(columns.channels)) if i not in mine]
        out[:, rest] = rows.average(columns.values[:, rest])
        out[:, mine] = rows.late(columns.values[:, mine], late, bowed=self.bowed)
        return Columns(columns.channels, out)

    def shifted(self, rows: Averages, scene: Scene, theta: Array) -> Array:
        """Return the averaged change (M, C) of what its channels deliver late."""
        places, simulated = list(self.places(scene)), scene.simulated
        mine = simulated if len(places) == simulated.shape[1] else simulated[:, places]
        out = np.zeros_like(rows.simulated)
        out[:, places] = rows.late(mine, float(theta[0]), bowed=self.bowed) - rows.simulated[:, places]
        return out


@dataclass(frozen=True)
class Lag(Filter):
    """A first-order response: T dy/dt = w - y; y - w is `share` times that (1 for a plain first order).

    With `damping` z one of second order: T^2 y'' + 2 z T y' + y = w, of a servo or a filter of two poles (0.71: Butterworth).
    With `speed_limit` v of a servo that is no faster, T dy/dt = w - y within +- T v: its supply or its profile limits it.

    `joint` restricts it to one joint; `whole`: the share is 1, for beside a delay it is hardly told from a shorter constant and
    runs away; `between`: see `BETWEEN`. Visible where the channels move quickly; nested with time_delay, to which it is the
    same for slow motion: a constant below `shortest` (half a sample) is none.
    """

    KEY = "lag"
    SAYS = (
        "the recording follows the simulation like a filter of the first order, or of the second where a damping is given; "
        "no faster than a speed limit where there is one"
    )
    KNOWN_BY = "it is large where the signal moves quickly and dies away where it rests"
    CONFIRMED_BY = "move one joint at two speeds, with quick starts"
    HEAD = ("constant", "damping", "speed_limit")
    ALIKE: ClassVar = {
        "friction": "a lag and viscous friction both follow the speed",
        "creep": "creep is a lag with a long time constant",
    }
    COMPLEXITY = 2
    BEHIND = ("time_delay",)
    """s + D (L s - s) + (D s - s) = D L s: a late clock delivers what the filter gives."""
    SEARCHED: ClassVar = {
        "constant": Searched(1e-4, 1e3, "s"),
        "damping": Searched(0.1, 0.98, "1"),
        "speed_limit": Searched(1e-4, 1e2, "rad/s or m/s"),
    }
    constant: float
    joint: str = ""
    shortest: float = 0.0
    whole: bool = False
    damping: float | None = None
    between: str = "lines"
    speed_limit: float | None = None

    @property
    def swings(self) -> bool:
        """Whether it is of second order."""
        return self.damping is not None

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield lags from half a sample to seconds, of first order; the second is asked where one of these is found."""
        if not scene.clock or not np.any(scene.simulated_rate):
            return
        shortest = 0.5 * spacing(scene)
        for constant in log_grid(shortest, max(1.0, 4.0 * shortest), 9):
            yield cls(constant, "", shortest)
            if scene.observations.predict == "position" and len(scene.channels) > 1:
                yield from (cls(constant, joint_of(name), shortest) for name in scene.channels)

    def with_searched(self, values: Mapping[str, float]) -> Self:
        """Return it at another point of the search, the constant not below the shortest that can be told from a delay."""
        found = super().with_searched(values)
        return replace(found, constant=max(found.constant, self.shortest))

    def richer(self, scene: Scene, *, slower: tuple[float, ...] = (1.0, 0.3, 0.1)) -> Iterator[Self]:
        """Yield it with a speed limit: far from the command all that is late may come of that, and the constant be short.

        Args:
            slower: shares of the constant that are tried with each limit.
        """
        if self.speed_limit is None:
            for share in slower:
                constant = max(share * self.constant, self.shortest)
                yield from replace(self, constant=constant, damping=None).limited(scene)

    def limited(self, scene: Scene, *, shares: tuple[float, ...] = (0.05, 0.15, 0.5)) -> Iterator[Self]:
        """Yield it with limits of the speed, of positions.

        Args:
            shares: of the fastest that it is without one.
        """
        places = list(self.places(scene))
        if scene.observations.predict != "position" or len({scene.units[c] for c in places}) > 1:
            return
        steps = np.diff(scene.time)[:, None]
        moved = np.abs(np.diff(self.filtered(scene, scene.simulated[:, places]), axis=0))
        fastest = float(np.max(np.divide(moved, steps, out=np.zeros_like(moved), where=steps > 0.0)))
        yield from (replace(self, speed_limit=share * fastest) for share in shares if fastest > 0.0)

    def beginning(self, scene: Scene, theta: Array, others: Sequence[Effect]) -> Beginning:
        """Return what the filter held. Of second order two numbers a channel would be free: enough to make one of a delay."""
        first = self.damping is None
        return Beginning(lags=(Lagging(self.places(scene), self.constant),) if first else ())

    def unlimited(self) -> Self:
        """Return it with any constant: a filter quicker than half a sample is a delay to this recording, but it may be there."""
        return replace(self, shortest=0.0)

    @property
    def freedom(self) -> int:
        """Number of free linear parameters, 0: all of the stream goes through it, or it is no lag."""
        return 0

    @property
    def held(self) -> Array | None:
        """A share of one: all of the stream goes through it."""
        return np.ones(1) if self.whole else None

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return how much of the stream goes through the lag."""
        return (Parameter("share", "1", 0.0, expected=1.0),)

    def columns(self, scene: Scene) -> Columns:
        """Return lagged less simulated."""
        places = self.places(scene)
        mine = scene.simulated[:, places]
        return Columns(places, (self.followed(scene, mine) - mine)[:, :, None])

    def followed(self, scene: Scene, x: Array) -> Array:
        """Return what follows simulated signals (N, m), with its speed limit."""
        if self.speed_limit is None:
            return self.filtered(scene, x)
        straight = straightened(scene, x, self.between)
        return scene.limited_lag(
            "limited", straight, self.constant, self.speed_limit, held=held_over(scene, self.between)
        )

    def retimed(self, scene: Scene, x: Array, theta: Array) -> Array:
        """Return signals (N, m) as this stream delivers them."""
        return x + float(theta[0]) * (self.filtered(scene, x) - x)

    def filtered(self, scene: Scene, x: Array) -> Array:
        """Return small signals (N, m), on top of what is simulated, behind the filter: no limit holds them."""
        if self.damping is not None:
            return second_order(scene, x, self.constant, self.damping, self.between)
        return first_order(scene, x, self.constant, self.between)


def held_over(scene: Scene, between: str) -> bool:
    """Return whether signals stand from row to row."""
    return scene.commanded or between == "steps"


def straightened(scene: Scene, x: Array, between: str) -> Array:
    """Return signals (N, m) whose straight lines between the rows stand for their parabolas, where they run along these."""
    return scene.straightened("bow", x) if between == "bows" else x


def first_order(scene: Scene, x: Array, constant: float, between: str) -> Array:
    """Return signals (N, m) behind a lag, see `BETWEEN`; commands stand."""
    return scene.lag("lag", x, constant, held=held_over(scene, between), bowed=between == "bows")


def second_order(scene: Scene, x: Array, constant: float, damping: float, between: str) -> Array:
    """Return signals (N, m) behind a lag of second order."""
    return scene.second_order("lag", straightened(scene, x, between), constant, damping, held=held_over(scene, between))
