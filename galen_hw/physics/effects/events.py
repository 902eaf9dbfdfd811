"""Effects that belong to moments: steps, contacts, oscillations, glitches. Where they sit is sought in the residual."""

import itertools
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns, in_each
from galen_hw.physics.effects.parameters import Parameter, Searched, unit_of
from galen_hw.physics.effects.traits import Follows, Line, Span
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.sensitivity import Carried
from galen_hw.spatial import Array


class _Sought(Effect):
    """Nothing on a fixed grid: `galen_hw.diagnosis.detection.spectral_lines` looks into the residual."""

    EPISODIC = True

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield nothing: it is sought in the residual."""
        del scene
        return iter(())


class _Shaped(_Sought):
    """The same shapes in time in every channel it names, each with a coefficient of its own."""

    channels: tuple[str, ...]

    @abstractmethod
    def shapes(self, scene: Scene, average: Callable[[Array], Array]) -> Array:
        """Return the shapes (M, n) with rows averaged, (N, ...) to (M, ...)."""

    def columns(self, scene: Scene) -> Columns:
        """Return every shape in every channel, channel by channel."""
        return self.averaged(scene, np.asarray)

    def averaged(self, scene: Scene, average: Callable[[Array], Array]) -> Columns:
        """Return shapes averaged before they are spread over the channels, where most of the columns are zero."""
        places = tuple(scene.channels.index(name) for name in self.channels)
        return in_each(places, self.shapes(scene, average))


@dataclass(frozen=True)
class Step(_Shaped):
    """The offset jumps at a moment: r = a for t >= t0. A bump, a re-zeroing, a moved marker.

    `carried` names what has slipped on the arm (a target, the tool): its jump has the body's axes, and turns with the arm; or
    the tracker, whose jump has its own axes.
    `later` holds the moments of further jumps in the same channels, to be asked together: of three none may pay alone.
    Visible with rest on both sides; not in motors' efforts, which have no zero. Confused with drift (smooth) and contact (which
    ends).
    """

    KEY = "step"
    SAYS = "the offset jumps at a moment"
    KNOWN_BY = "before and after the moment the residual is level"
    HEAD = ("jump_.*",)
    RMS_TOLD = True
    ALIKE: ClassVar = {
        "drift": "one jump and a quick slope differ only near the moment",
        "contact": "the force does not end before the recording does",
    }
    SIDE_BY_SIDE = True
    channels: tuple[str, ...]
    moment: float
    carried: str = ""
    later: tuple[float, ...] = ()

    @property
    def jump(self) -> float:
        """The moment, s, of its first jump."""
        return self.moment

    def jumping(self, moment: float) -> Self:
        """Return it with its first jump moved."""
        return replace(self, moment=moment)

    def staged(self, start: float, length: float) -> Self:
        """Return it with the jump in the middle."""
        return self.jumping(start + 0.5 * length)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: time."""
        return Follows("time")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the jump of every channel, or shifts and turns of what has slipped."""
        if self.carried:
            return tuple(Parameter(f"jump_{self.carried}_{move}", unit) for move, unit in self._slipped(scene).moves)
        each = ("jump", *(f"jump{k}" for k in range(2, 2 + len(self.later))))
        return tuple(Parameter(f"{jump}_{name}", unit_of(scene, name)) for name in self.channels for jump in each)

    def possible(self, scene: Scene, theta: Array, spread: Array) -> bool:
        """Return whether the channel has a zero: what comes at once to a motor's effort, and stays, is a force."""
        return scene.observations.predict != "effort"

    @property
    def single(self) -> tuple[Self, ...]:
        """Each jump by itself, of several."""
        return tuple(replace(self, moment=t, later=()) for t in (self.moment, *self.later)) if self.later else ()

    def _slipped(self, scene: Scene) -> Carried:
        return next(one for one in scene.slipping() if one.name == self.carried)

    def averaged(self, scene: Scene, average: Callable[[Array], Array]) -> Columns:
        """Return what is averaged of all that has a shape, or what the slip does in every pose after it."""
        if not self.carried:
            return super().averaged(scene, average)
        slipped = self._slipped(scene)
        return Columns(slipped.channels, average(slipped.values * (scene.time >= self.moment)[:, None, None]))

    def shapes(self, scene: Scene, average: Callable[[Array], Array]) -> Array:
        """Return one step after each moment."""
        after = scene.time[:, None] >= np.array([self.moment, *self.later])
        return average(scene.seen(after.astype(float)))


@dataclass(frozen=True)
class Contact(_Shaped):
    """An outside force during episodes (start, end) in s: in each, a level and a bow in every channel named.

    A hand that swells, turns and lets go needs more than that: `waves` half waves of the episode, the bow being the first.
    Visible as a residual that comes and goes. Confused with glitches (a few samples), step (which stays) and payload.
    """

    KEY = "contact"
    SAYS = "an outside force acts during some episodes"
    KNOWN_BY = "it comes and goes at moments, and nothing is left between them"
    CONFIRMED_BY = "repeat the same path in free air"
    RMS_TOLD = True
    REMOVED_BY = "repeat the motion in free air, nothing near the arm"
    SIDE_BY_SIDE = True
    channels: tuple[str, ...]
    episodes: tuple[Span, ...]
    waves: int = 1

    @property
    def touches(self) -> tuple[Span, ...]:
        """The episodes that it acts in."""
        return self.episodes

    def finer(self, time: Array, *, hand: int = 5, finest: int = 96, rows: int = 4, most: int = 1000) -> Iterator[Self]:
        """Yield it with more half waves, twice as many each time, and no more than its episodes and memory can bear.

        Args:
            hand: half waves that a hand which swells and turns asks for at first, where a knock is a level and a bow.
            finest: half waves of an episode at most; rows: of the shortest episode that a half wave has at least.
            most: columns that a touch may have, level and waves of all episodes and channels.
        """
        shortest = min(int(np.sum((time >= start) & (time <= end))) for start, end in self.episodes)
        places = len(self.episodes) * len(self.channels)
        waves = max(2 * self.waves, hand)
        while waves <= min(finest, shortest // rows, most // places):
            yield replace(self, waves=waves)
            waves *= 2

    def staged(self, start: float, length: float) -> Self:
        """Return it once, for a tenth of the time."""
        return replace(self, episodes=((start + 0.3 * length, start + 0.4 * length),))

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: time."""
        return Follows("time")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return level, bow and further half waves per channel and episode."""
        return tuple(
            Parameter(f"{what}_{k + 1}_{name}", unit_of(scene, name))
            for name in self.channels
            for k in range(len(self.episodes))
            for what in ("level", "bow", *(f"wave{i}" for i in range(2, self.waves + 1)))
        )

    def parted(self, count: int) -> Self:
        """Return the same contacts, each in so many parts of equal length."""
        edges = [np.linspace(start, end, count + 1).tolist() for start, end in self.episodes]
        return replace(self, episodes=tuple(part for edge in edges for part in itertools.pairwise(edge)))

    def unshaped(self, step: float, *, parts: int = 6) -> tuple[Effect, ...]:
        """Return how it swells and turns round inside an episode, and what happens about where that begins and ends.

        Args:
            parts: of an episode, in each of which a touch may be otherwise and is no noise for that.
        """
        around = tuple((t - step, t + step) for episode in self.episodes for t in episode)
        edges = (replace(self, episodes=around, waves=1).parted(2),) if step > 0.0 else ()
        return (self.parted(parts), *edges)

    def shapes(self, scene: Scene, average: Callable[[Array], Array]) -> Array:
        """Return box and half sines of every episode; averaged one by one, since there may be a thousand of them."""
        out = []
        for start, end in self.episodes:
            inside = ((scene.time >= start) & (scene.time <= end)).astype(float)
            phase = np.pi * (scene.time - start) / max(end - start, 1e-9)
            out.append(average(inside))
            out += [average(inside * np.sin(i * phase)) for i in range(1, self.waves + 1)]
        return np.stack(out, axis=-1)


@dataclass(frozen=True)
class Vibration(_Shaped):
    """Narrow-band oscillation: r = a sin(2 pi f t) + b cos(2 pi f t). Structure, mains, motor.

    A hum is no clock: with `wander`, a and b are each a constant and so many half cosines over the recording, so that phase
    and strength may go slowly to and fro. Visible as a line in the spectrum. Confused with torque_ripple at constant speed; an
    oscillation that motion excites and that dies away is not it.
    """

    KEY = "vibration"
    SAYS = "an oscillation of one frequency"
    KNOWN_BY = "it is one line of the spectrum, above what the joints themselves do"
    CONFIRMED_BY = "hold still for a minute with the motors on, then off"
    HEAD = ("frequency",)
    RMS_TOLD = True
    ALIKE: ClassVar = {"torque_ripple": "the joint turns at nearly constant speed"}
    REMOVED_BY = "repeat the motion with the source of the vibration switched off"
    SIDE_BY_SIDE = True
    THROUGHOUT = True
    SEARCHED: ClassVar = {"frequency": Searched(1e-2, 1e5, "Hz")}
    NEEDS_CLOCK = True
    channels: tuple[str, ...]
    frequency: float
    wander: int = 0

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return sine and cosine of every channel, and each again with every slow change."""
        waves = [f"{w}{f'_{k}' if k else ''}" for k in range(self.wander + 1) for w in ("sine", "cosine")]
        return tuple(Parameter(f"{w}_{name}", unit_of(scene, name)) for name in self.channels for w in waves)

    def doubt(self, scene: Scene) -> float:
        """Return one line's width: a line is as narrow as the recording is long, and beside it the fit has the next hump."""
        return 1.0 + 1.0 / (float(np.ptp(scene.time)) * self.frequency)

    def line(self, scene: Scene) -> Line:
        """Return its own spectral line."""
        return Line(self.frequency, self.breadth(scene), self.wander > 0)

    def indistinct(self, other: Effect, span: float, *, share: float = 0.1) -> bool:
        """Return whether sines so near stay in step over the whole recording.

        Args:
            share: of what two lines of the spectrum are apart that one recording can tell.
        """
        near = share / max(span, 1e-9)
        return isinstance(other, Vibration) and abs(other.frequency - self.frequency) < near

    def again(self, start: float, length: float) -> tuple[Effect, ...]:
        """Return it in another phase."""
        return (self,)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: time, periodically."""
        return Follows("time", period=1.0 / self.frequency)

    def breadth(self, scene: Scene) -> float:
        """Return the Hz to either side that belong to it: what its slow changes reach, and one line of the spectrum more."""
        return (0.5 * self.wander + 1.0) / max(float(np.ptp((scene.whole or scene).time)), 1e-9)

    def shapes(self, scene: Scene, average: Callable[[Array], Array]) -> Array:
        """Return sine and cosine of the clock, growing and fading slowly.

        Waves and their slow changes are averaged apart: over neighbouring rows a slow change is a constant.
        """
        phase, whole = 2.0 * np.pi * self.frequency * scene.time, scene.whole or scene
        waves = average(scene.seen(np.stack([np.sin(phase), np.cos(phase)], axis=-1)))
        since, span = average(scene.time) - whole.time[0], max(float(np.ptp(whole.time)), 1e-9)
        slow = [np.cos(np.pi * k * since / span) for k in range(self.wander + 1)]
        return np.concatenate([s[:, None] * waves for s in slow], axis=1)


@dataclass(frozen=True)
class Glitches(_Sought):
    """Isolated outliers, drop-outs and repeated samples: rows that are left out rather than modelled.

    Visible as single rows far off. Confused with contact (longer).
    """

    KEY = "glitches"
    SAYS = "isolated or repeated samples, far off what is measured around them"
    HEAD = ("size",)
    channels: tuple[str, ...]
    rows: tuple[int, ...] = ()

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return no parameters: the rows are left out."""
        return ()

    def columns(self, scene: Scene) -> Columns:
        """Return no columns."""
        places = tuple(scene.channels.index(name) for name in self.channels)
        return Columns(places, np.zeros((len(scene), len(places), 0)))


@dataclass(frozen=True)
class Unknown(_Sought):
    """Structure that nothing named explains: no physics, hence no model here, and nothing that the live services could use."""

    KEY = "unknown"
    SAYS = "structure that nothing named explains"
    channels: tuple[str, ...] = ()

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return no parameters."""
        return ()

    def columns(self, scene: Scene) -> Columns:
        """Return no columns."""
        return Columns((0,), np.zeros((len(scene), 1, 0)))
