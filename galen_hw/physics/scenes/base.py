"""A scene: one recording made ready for the effects: what was measured, what was simulated, and the ports of physics.

A port says how the compared channels answer to a small cause: a joint's position, gravity, a body's mass, a turned frame.
An effect is then the same few lines whichever group is compared, and does nothing where its port is not there.
"""

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import wraps
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from galen_hw.lazy import cached_property
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.operators.stateful import Memory, Operated
from galen_hw.physics.scenes.initial_state import Beginning
from galen_hw.physics.scenes.screws import forget
from galen_hw.physics.scenes.sensitivity import Carried, Port
from galen_hw.physics.signals.differentiation import derivatives, ends
from galen_hw.spatial import Array

BANDS = (40.0, 20.0, 10.0, 5.0, 2.5)
"""Low-passes in Hz that are tried on noisy motion."""

F = TypeVar("F", bound=Callable[..., Any])

Known = Callable[["Scene", Sequence[Mapping[str, Any]]], Array]
"""Gives (N, C) what the terms of the tool's file add to a scene's simulation; effects know that, scenes do not."""


_FIRST = threading.RLock()
"""Two searches may ask at once."""


def once(method: F) -> F:
    """Compute once an instance and argument: ports are asked for by many effects."""

    @wraps(method)
    def held(self: Any, *args: Any) -> Any:
        known = self.__dict__.setdefault("_once", {})
        key = (method.__qualname__, *args)
        if key not in known:
            with _FIRST:
                if key not in known:
                    known[key] = method(self, *args)
        return known[key]

    return held  # type: ignore[return-value]


class Scene(Operated):
    """What is common to all groups; the channels and ports come from its subclasses.

    Args:
        observations: the recording or one live sample.
        rates: joint velocities and accelerations (N, n) where they are known better than by differentiating.
        memory: states of the operators; None for a batch, which starts afresh in every segment.
        known: needed where the belief holds further terms of a tool.
    """

    channels: tuple[str, ...] = ()
    rotational: tuple[bool, ...] = ()
    units: tuple[str, ...] = ()
    standing: Array | float = 0.0
    """(C,) constants that a model has found beside the simulation."""
    carried: Array | float = 0.0
    """(N, C) all else that it adds before it is read."""
    limited: frozenset[str] = frozenset()
    """Channels with a limit in the model: what is carried does not show there while they clip."""
    beginning: Beginning = Beginning()
    """What is known of the answers to what came before the recording."""
    whole: "Self | None" = None
    """Of a single row: the recording that it belongs to, which knows what one row cannot show."""

    def __init__(
        self,
        observations: Observations,
        rates: tuple[Array, Array] | None = None,
        memory: Memory | None = None,
        known: Known | None = None,
    ) -> None:
        self.observations, self._rates, self.memory, self.known = observations, rates, memory, known
        self.belief: Belief = observations.belief
        self.segments = observations.segments
        self.joint_names = observations.joint_names
        time = observations.time
        self.clock = time is not None
        self.time: Array = np.arange(len(observations), dtype=float) if time is None else np.asarray(time)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.observations)

    def carrying(self, standing: Array | float, carried: Array | float, limited: Iterable[str] = ()) -> Self:
        """Return the scene with what a model adds to its simulation: a reading that clips, clips all of it."""
        one = copy(self)
        one.standing, one.carried, one.limited = standing, carried, frozenset(limited)
        return one

    def begun(self, beginning: Beginning) -> Self:
        """Return the scene with another beginning."""
        one = copy(self)
        one.beginning = beginning
        return one

    @property
    def unanswered(self) -> NDArray[np.bool_]:
        """(N,) rows that answer to what nobody recorded."""
        return self.beginning.unknown(self.time, self.segments)

    def reading(self, simulated: Array) -> Self:
        """Return the scene with something else (N, C) that is simulated."""
        return self._otherwise(simulated=simulated)

    def with_body(self, body: Array) -> Self | None:
        """Return the scene of a machine with a further body, of inertial parameters (10,) as of `body_port`; None: unknown.

        What is simulated stays as it is.
        """
        return None

    def standing_at(self, joint: str, *, offset: float = 0.0, scale: float = 0.0) -> Self | None:
        """Return the scene of an arm whose joint stands at (1 + scale) q + offset; None: nothing else would change.

        What is simulated stays as it is.
        """
        return None

    def under(self, gravity: Array) -> Self | None:
        """Return the scene under another gravity (3,) in the base, m/s^2; None: nothing else would change."""
        return None

    def _stretched(self, joint: str, offset: float, scale: float) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (N, n) of an arm whose joint stands at (1 + scale) q + offset where q is read."""
        j = self.joint_index(joint)
        q, dq, ddq = (x.copy() for x in (self.q, *self.rates))
        for x in (q, dq, ddq):
            x[:, j] *= 1.0 + scale
        q[:, j] += offset
        return q, dq, ddq

    def _otherwise(self, **values: Any) -> Self:
        """Return a copy with other attributes; what was computed from the old ones is forgotten, but not what was simulated."""
        kept = {
            "simulated": self.simulated,
            "measured": self.measured,
            "q": self.q,
            "rates": self.rates,
            "band": self.band,
        }
        one = copy(self)
        for name in [n for n in vars(one) if isinstance(getattr(type(one), n, None), cached_property)]:
            del vars(one)[name]
        vars(one).pop("_once", None)
        vars(one).update(kept | values)
        if "q" in values:
            forget(one)
        return one

    def row(self, k: int, memory: Memory) -> Self:
        """Return row k by itself, as a live sample; `memory` is handed on from row to row."""
        at = slice(k, k + 1)
        rates = (self.rates[0][at], self.rates[1][at])
        one = type(self)(self.observations.taken(at), rates=rates, memory=memory, known=self.known)
        one.whole = self
        return one

    @cached_property
    def measured(self) -> Array:
        """(N, C) of the compared group as recorded."""
        return self.observations.matrix(*self.channels)

    @cached_property
    def simulated(self) -> Array:
        """(N, C) of the compared group as the baseline has it."""
        given = self.observations.simulation
        if given is not None:
            missing = np.full(len(self), np.nan)
            return np.stack([np.asarray(given.get(name, missing)) for name in self.channels], axis=-1)
        return self._simulate() + self._known_effects() if self.belief.terms else self._simulate()

    def _known_effects(self) -> Array:
        """Return what (N, C) the terms of the tool's file add; they see the simulation without them, as in the live services."""
        assert self.known is not None, "a scene whose tool has further terms is told what they add"
        plain = replace(self.observations, belief=replace(self.belief, terms=()))
        return self.known(type(self)(plain, rates=self.rates), self.belief.terms)

    def _simulate(self) -> Array:
        raise AssertionError("a scene without its own simulation needs a given one")

    @property
    def grain(self) -> int:
        """How many neighbouring rows hold one independent value: more than one where `measured` is filtered."""
        return 1

    @property
    def cut(self) -> float:
        """Cycles a row above which the recording was filtered before it was stored; 0: nowhere."""
        return 0.0

    def seen(self, x: Array) -> Array:
        """Return sharp signals (N, k) as `measured` shows them: through the same filter, where it is filtered."""
        return x

    @property
    def raw_residual(self) -> Array:
        """(N, C) recorded as it is, minus simulated."""
        return self.observations.matrix(*self.channels) - self.simulated

    @property
    def residual(self) -> Array:
        """(N, C) recorded minus simulated."""
        return self.measured - self.simulated

    @cached_property
    def q(self) -> Array:
        """(N, n) joint positions that drive the effects."""
        return self.observations.joints("position")

    @cached_property
    def rates(self) -> tuple[Array, Array]:
        """dq, ddq (N, n); zeros without a clock."""
        if self._rates is not None:
            return self._rates
        if not self.clock or not self.joint_names:
            return np.zeros_like(self.q), np.zeros_like(self.q)
        return self._derivatives(self.band)

    def _derivatives(self, band: float | None) -> tuple[Array, Array]:
        # Positions are predicted from commands, which nobody measures.
        measured = self.observations.predict != "position"
        velocity = self.observations.joints("velocity") if measured else None
        return derivatives(self.time, self.q, self.segments, velocity, band, fine=measured)

    @cached_property
    def band(self) -> float | None:
        """Of the low-passes (Hz) of the motion the one whose simulation meets the recording best; None: by the motion alone.

        A low-pass without phase can neither hide nor fake a delay; noise of measured motion that is differentiated
        would otherwise pass for forces.
        """
        if self._rates is not None or not self.clock:
            return None
        if self.observations.simulation is not None or not self._uses_rates():
            return None
        step = float(np.median(np.diff(self.time)))
        if step <= 0.0:
            return None  # rows that share a stamp are no motion
        middle = max(self.segments, key=lambda part: part.stop - part.start)
        rows = slice(middle.start, min(middle.stop, middle.start + 8000))
        part = type(self)(self.observations.taken(rows), known=self.known)
        bands = [None, *(b for b in BANDS if b < 0.25 / step and not part.loses(b))]
        errors = [part.error_with(band) for band in bands]
        best = int(np.argmin(errors))
        return bands[best] if errors[best] < errors[0] - 0.05 else None

    @cached_property
    def ends(self) -> NDArray[np.bool_]:
        """(N,) rows at the segments' ends, where the speed and acceleration of what moves are not known."""
        if self._rates is not None or not self.clock or not self.moved:
            return np.zeros(len(self), dtype=bool)
        moved = self.q[:, [self.joint_index(name) for name in self.moved]]
        return ends(self.time, moved, self.segments, self.band)

    def _uses_rates(self) -> bool:
        """Return whether the baseline differentiates the motion."""
        return False

    @property
    def heard(self) -> float | None:
        """Frequency (Hz) above which the compared channels were filtered; None: they are as recorded."""
        return None

    def loses(self, band: float) -> bool:
        """Return whether a vibration would go with what a low-pass of the motion (Hz) takes."""
        return False

    def error_with(self, band: float | None) -> float:
        """Return the mean log spread of the residual and of its changes by row, the motion low-passed at `band` Hz.

        The spread is the median's: jumps of force, which any low-pass smears, are few and must not decide.
        """
        rest = type(self)(self.observations, rates=self._derivatives(band), known=self.known).raw_residual
        rest = rest[len(rest) // 20 : -max(len(rest) // 20, 1)]
        rest = rest[:, np.isfinite(rest).any(axis=0)]  # of a joint that was not measured nothing is missed
        quick = np.diff(rest, axis=0)
        return float(np.mean(np.log(_spread(rest) + 1e-300) + np.log(_spread(quick) + 1e-300)))

    @cached_property
    def simulated_rate(self) -> Array:
        """(N, C) time derivative of the simulated channels."""
        measured = self.observations.predict != "position"
        return derivatives(self.time, self.simulated, self.segments, fine=measured)[0]

    def joint_index(self, name: str) -> int:
        """Return the place of a joint."""
        return self.joint_names.index(name)

    def joint_units(self, joint: str) -> tuple[str, str]:
        """Return the units of a joint's position and load: m and N where it slides, rad and N m where it turns."""
        return ("m", "N") if self.belief.slides(joint) else ("rad", "N m")

    def compliance_unit(self, joint: str) -> str:
        """Return the unit of a joint's compliance: m/N where it slides, rad/(N m) where it turns."""
        return "m/N" if self.belief.slides(joint) else "rad/(N m)"

    @cached_property
    def moved(self) -> tuple[str, ...]:
        """Joints whose position is known and changes."""
        spread = np.ptp(self.q, axis=0) if self.q.size else np.zeros(len(self.joint_names))
        return tuple(name for name, d in zip(self.joint_names, spread, strict=True) if np.isfinite(d) and d > 1e-6)

    # -- ports: None where the physics cannot show in this group or recording ------------------------------------------

    def joint_port(self, joint: str) -> Array | None:
        """Return the answer (N, C) to an error of a joint's position, per rad or m."""
        return None

    @once
    def reached(self, joint: str) -> tuple[int, ...]:
        """Return the channels in which an error of a joint's position shows; all where it shows in none."""
        port = self.joint_port(joint)
        live = [] if port is None else np.flatnonzero(port.any(axis=0)).tolist()
        return tuple(live or range(len(self.channels)))

    @once
    def reaching(self, joint: str) -> Array:
        """Return the port (N, n) of a joint that has one, in these channels."""
        port, live = self.joint_port(joint), self.reached(joint)
        assert port is not None, "proposed only where there is a port"
        return port if len(live) == port.shape[1] else port[:, live]

    def misread(self, joint: str, *, offset: float = 0.0, scale: float = 0.0) -> Array | None:
        """Return the change (N, C), exactly, if a joint stands at (1 + scale) q + offset; None: the port must do."""
        return None

    def gravity_port(self) -> Array | None:
        """Return the answer (N, C, 3) to gravity in the base, per m/s^2."""
        return None

    def body_port(self) -> Array | None:
        """Return the answer (N, C, 10) to a body on the sensor or tip: m, m c (3), inertia xx xy yy xz yz zz about its origin."""
        return None

    def carried_mass(self, joint: str = "") -> float:
        """Return what the link that a joint moves is believed to weigh, kg, of the link at the sensor for ""; 0: not known."""
        del joint
        return self.belief.tool.mass

    def weight_port(self) -> Array | None:
        """Return the answer (N, C, 10) to its weight alone, as if nothing accelerated it."""
        return None

    def inertial_port(self) -> Array | None:
        """Return what (N, C) the known bodies' inertia adds, where the baseline holds weight alone."""
        return None

    def turn_port(self) -> Array | None:
        """Return what (N, C, 3) acceleration adds per m from the centre of turn, sensor axes; None: no turn, or it is known."""
        return None

    def load(self, joint: str) -> Array | None:
        """Return the force or torque (N,) that bends a joint, N or N m."""
        return None

    def geometry_ports(self) -> list[Port]:
        """Return the small errors of links and axes."""
        return []

    def screw_port(self, screws: list[Array]) -> Array | None:
        """Return the exact answer (N, C) to the sensor moved by exp(s_1) exp(s_2) ..., screws [v, w] (N, 6) in the base."""
        return None

    @property
    def turned(self) -> tuple[str, ...]:
        """Channels that are turns since the first row, and no readings: they have neither scale nor limit."""
        return ()

    @property
    def commanded(self) -> bool:
        """Whether what is compared answers to a command, which stands from one row to the next; a simulated answer does not."""
        return self.observations.predict == "position" and self.observations.simulation is None

    def swept_port(self, joint: str, error: str) -> Array | None:
        """Return what (N, C) the arm's motion adds to a geometry port, per rad or m; None where it adds nothing."""
        return None

    def slipping(self) -> list[Carried]:
        """Return what may slip on the arm; nothing where the channels are not of a place."""
        return []

    def nuisances(self) -> list[Array]:
        """Return columns (N, C) that the baseline fits before it is compared (a tracker's frame), constants apart."""
        return []

    @property
    def zeroing(self) -> "Scene | None":
        """One row: what was zeroed away, where it was; None where nothing was, or where the joints stood is not known."""
        return None

    def response(self, joint: str) -> float | None:
        """Return the time constant (s) with which a simulated servo follows its command; None where there is none to be told."""
        return None

    def inertia_load(self, joint: str) -> Array | None:
        """Return the load (N,) of a joint by motion alone, where weight may be balanced; None where that is not known."""
        return None

    def weight_load(self, joint: str) -> Array | None:
        """Return the load (N,) of a joint by weight alone; None where that is not known."""
        return None

    def resting(self, channel: str) -> Array | None:
        """Return where (segments, 1) the far side of a play in a channel stands as every segment starts; None: at its input."""
        return None


def _spread(x: Array) -> Array:
    """Return the robust spread (C,) of (N, C)."""
    return np.asarray(np.nanmedian(np.abs(x - np.nanmedian(x, axis=0)), axis=0))
