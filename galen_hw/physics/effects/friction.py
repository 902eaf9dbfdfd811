"""Effects that act in a joint: friction and torque ripple."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns, in_channel
from galen_hw.physics.effects.parameters import Parameter, Searched, duration, log_grid, spacing
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

MOST_KEPT = 6e7
"""Values of servos' stand-offs that a scene keeps (half a gigabyte), those asked for last: they are walked row by row."""

_KEEPING = threading.Lock()
"""Of these; two searches may ask at once."""


@dataclass(frozen=True)
class Friction(Effect):
    """Friction in a joint: r = Fc s + Fv v with s = tanh(v / v0), and its kin.

    "asymmetric": own Fc and Fv by direction; "unequal": own Fv alone, where a free constant has what differs of Fc;
    "stribeck": + Fs s exp(-(v / vs)^2) (Armstrong-Helouvry 1994); "load": + c |load| s; "presliding": s is built up over
    `reach` of the joint after each turn, at any speed (Dahl 1976), with "_stribeck" as LuGre's bristles slip (Canudas de Wit
    1995); "warming": + (Fc' s + Fv' v) exp(-t / T) of grease that is cold at its `start`. In efforts it adds to the motor's
    work; a servo without integral action stands off by friction over stiffness (positions, negative). "servo": the same with
    its sticking at reversals, T dq/dt = z(c - q), z a dead zone of +- `coulomb` (friction over stiffness), T the servo's
    `response` and c its command s, beside the lag of such a servo without friction; T not below `shortest` (half a sample:
    what follows quicker and sticks has a play). Of a `simulated` servo, whose T the simulation and its command tell, c is what
    makes it move as simulated (s + T ds/dt). "creeping_servo": friction that is viscous at creeping speed, so that it gives
    way with a time constant `settling` while it sticks; either with "_viscous": what more damping holds it back, - b ds/dt
    behind the response.
    Visible at reversals and at several speeds. Confused with hysteresis and backlash (small widths; a quick servo that sticks
    has the play of its command), time_delay and viscous lag, payload where speed follows gravity.
    """

    KEY = "friction"
    SAYS = "friction in the joint"
    KNOWN_BY = "it follows the direction and the size of the joint's speed"
    CONFIRMED_BY = "sweep each joint both ways at three speeds"
    HEAD = ("coulomb", "coulomb_forward", "coulomb_backward", "viscous.*", "stiction", "cold_.*")
    COMPLEXITY = 1
    SEARCHED: ClassVar = {
        "transition": Searched(1e-6, 10.0, "rad/s or m/s"),
        "stribeck": Searched(1e-5, 10.0, "rad/s or m/s"),
        "reach": Searched(1e-7, 1.0, "rad or m"),
        "coulomb": Searched(1e-7, 1.0, "rad or m"),
        "response": Searched(1e-3, 1.0, "s"),
        "settling": Searched(1e-2, 1e3, "s"),
        "warming": Searched(1.0, 1e5, "s"),
    }
    NEEDS_CLOCK = True
    joint: str
    form: str
    transition: float | None = None
    stribeck: float | None = None
    reach: float | None = None
    coulomb: float | None = None
    response: float | None = None
    settling: float | None = None
    warming: float | None = None
    start: float | None = None
    simulated: float | None = None
    shortest: float = 0.0

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every joint that moves, with sharp and soft transitions."""
        if scene.observations.predict not in ("effort", "position") or not scene.clock:
            return
        compared = {joint_of(name) for name in scene.channels}
        for joint in scene.moved:
            speed = float(np.nanstd(scene.rates[0][:, scene.joint_index(joint)]))
            if joint not in compared or speed <= 0.0:
                continue
            yield cls(joint, "viscous", 0.05 * speed)
            # Beside a free constant the two Coulomb parts of a joint that hardly rests are one, and differ by that constant.
            unequal = "unequal" if scene.belief.bias_free else "asymmetric"
            forms = ("coulomb", "coulomb_viscous", *((unequal, "load") if _is_effort(scene) else ()))
            for sharp in (0.01, 0.05, 0.2):
                yield from (cls(joint, form, sharp * speed) for form in forms)
            if _is_effort(scene):
                yield from (cls(joint, "stribeck", 0.05 * speed, vs * speed) for vs in (0.1, 0.3))
                if scene.belief.robot is not None:  # of a device that nobody knows a linear part may be simulated
                    yield from cls._presliding(scene, joint, speed)
                    yield from cls._warming(scene, joint, speed)
            else:
                yield from cls._in_servos(scene, joint)

    @classmethod
    def _presliding(cls, scene: Scene, joint: str, speed: float) -> Iterator[Self]:
        """Yield friction that builds up over a thousandth to a twentieth of the joint's range, without and with stiction."""
        half_range = 0.5 * float(np.ptp(scene.q[:, scene.joint_index(joint)]))
        for reach in log_grid(1e-3 * half_range, 5e-2 * half_range, 4):
            yield cls(joint, "presliding", reach=reach)
            yield cls(joint, "presliding_stribeck", stribeck=0.1 * speed, reach=reach)

    @classmethod
    def _warming(cls, scene: Scene, joint: str, speed: float) -> Iterator[Self]:
        """Yield cold grease that warms within a tenth to the whole of a recording."""
        length = duration(scene)
        cold = {"transition": 0.05 * speed, "start": float(scene.time[0])}
        yield from (cls(joint, "warming", warming=t, **cold) for t in log_grid(0.1 * length, length, 3))

    @classmethod
    def _in_servos(
        cls, scene: Scene, joint: str, *, response: float = 0.03, settlings: tuple[float, ...] = (4.0, 16.0)
    ) -> Iterator[Self]:
        """Yield stand-offs from far below the joint's range to a tenth of it; those that creep, quickly and slowly.

        Args:
            response: time constant of a position servo to begin with, s, where no simulation tells it.
            settlings: so many times slower, to begin with, a servo settles that sticks.
        """
        half_range = 0.5 * float(np.ptp(scene.q[:, scene.joint_index(joint)]))
        known = scene.response(joint)
        shortest = 0.5 * spacing(scene)
        given = {"response": max(response, shortest), "shortest": shortest} if known is None else {"simulated": known}
        for coulomb in log_grid(half_range * 1e-4, half_range * 0.1, 11):
            for settling in (None, *(one * (known or response) for one in settlings)):
                form = "servo" if settling is None else "creeping_servo"
                yield cls(joint, form, coulomb=coulomb, settling=settling, **given)
                if known is not None:  # else a lag or a delay of the joint is as much
                    yield cls(joint, f"{form}_viscous", coulomb=coulomb, settling=settling, **given)

    @classmethod
    def from_term(cls, parameters: Mapping[str, Any]) -> Self:
        """Return the effect of a term: a servo's stand-off is searched, in other forms the name is that of a linear parameter."""
        form = {k: v for k, v in parameters.items() if k != "coulomb" or "servo" in str(parameters.get("form", ""))}
        return super().from_term(form)

    @property
    def freedom(self) -> int | None:
        """Number of free linear parameters: a servo stands off by all of its friction, whose size is searched."""
        return (1 if self.form.endswith("_viscous") else 0) if "servo" in self.form else None

    @property
    def complexity(self) -> int:
        """As common as a play, where it is one with the response of a servo besides."""
        return self.COMPLEXITY if self.freedom is None else self.COMPLEXITY + 1

    def pinned(self, scene: Scene) -> Array | None:
        """Return the share, and nan for a free viscous part."""
        return None if self.freedom is None else np.array([1.0] + self.freedom * [np.nan])

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return Coulomb in the channel's unit, viscous per speed."""
        unit = scene.units[_place(scene, self.joint)]
        low, high = (0.0, np.inf) if _is_effort(scene) else (-np.inf, 0.0)
        c = Parameter("coulomb", unit, low, high)
        v = Parameter("viscous", {"N m": "N m/(rad/s)", "N": "N s/m"}.get(unit, "s"))
        if self.form == "asymmetric":
            return (
                Parameter("coulomb_forward", unit, low, high),
                Parameter("viscous_forward", v.unit, low, high),
                Parameter("coulomb_backward", unit, low, high),
                Parameter("viscous_backward", v.unit, low, high),
            )
        if self.form == "unequal":
            return c, *(Parameter(f"viscous_{way}", v.unit, low, high) for way in ("forward", "backward"))
        if self.freedom is not None:
            return (Parameter("share", "1", 0.0, expected=1.0), Parameter("viscous", "s", 0.0))[: 1 + self.freedom]
        if self.form == "warming":
            return c, v, Parameter("cold_coulomb", unit, low, high), Parameter("cold_viscous", v.unit, low, high)
        stiction, load = Parameter("stiction", unit, low, high), Parameter("load_share", "1", low, high)
        extra = {"stribeck": stiction, "presliding_stribeck": stiction, "load": load}
        plain = {"coulomb": (c,), "viscous": (v,), "coulomb_viscous": (c, v), "presliding": (c, v)}
        return plain.get(self.form) or (c, v, extra[self.form])

    @classmethod
    def ahead(cls, scene: Scene, effects: Sequence[Self], *, together: float = 1.5e7) -> None:
        """Keep the stand-offs of servos, as many as the scene keeps.

        Args:
            together: values of stand-offs that are walked side by side.
        """
        kept = _kept(scene)
        sticking = {one.servo: one for one in effects if one.freedom is not None}
        new = [one for servo, one in sticking.items() if servo not in kept][: int(MOST_KEPT / len(scene))]
        most = max(int(together / len(scene)), 1)
        for few in (new[i : i + most] for i in range(0, len(new), most)):
            for one, stands in zip(few, _stand_offs(scene, few), strict=True):
                kept[one.servo] = stands

    def columns(self, scene: Scene) -> Columns:
        """Return functions of the joint's speed in its channel, or what a servo that sticks does beside one that does not."""
        v = scene.rates[0][:, scene.joint_index(self.joint)]
        if self.freedom is not None:
            return in_channel(_place(scene, self.joint), self._servo(scene, v))
        s = self._sense(scene, v)
        forward = 0.5 * (1.0 + s)

        def cold() -> Array:
            # A recording of an earlier day says nothing of how cold it was before.
            return np.asarray(np.exp(-np.maximum(scene.time - (self.start or 0.0), 0.0) / (self.warming or 1.0)))

        forms: dict[str, Callable[[], list[Array]]] = {
            "coulomb": lambda: [s],
            "viscous": lambda: [v],
            "coulomb_viscous": lambda: [s, v],
            "asymmetric": lambda: [s * forward, v * forward, s * (1.0 - forward), v * (1.0 - forward)],
            "unequal": lambda: [s, v * forward, v * (1.0 - forward)],
            "stribeck": lambda: [s, v, s * np.exp(-((v / (self.stribeck or 1.0)) ** 2))],
            "warming": lambda: [s, v, s * cold(), v * cold()],
            "load": lambda: [s, v, s * np.abs(np.asarray(scene.load(self.joint), dtype=float))],
        }
        forms |= {"presliding": forms["coulomb_viscous"], "presliding_stribeck": forms["stribeck"]}
        return in_channel(_place(scene, self.joint), scene.seen(np.stack(forms[self.form](), axis=-1)).T)

    def _sense(self, scene: Scene, v: Array) -> Array:
        """Return the sense of the motion (N,), -1 to 1: of its speed (N,), rad/s, or as built up since the joint turned."""
        if self.reach is not None:
            return scene.wear("presliding", scene.q[:, scene.joint_index(self.joint)], self.reach, 1.0)
        assert self.transition is not None, "proposed with one"
        return np.asarray(np.tanh(v / self.transition))

    def with_searched(self, values: Mapping[str, float]) -> Self:
        """Return another point of the search; a servo that follows within half a sample is none, and friction in it a play."""
        if "response" in values:
            values = {**values, "response": max(values["response"], self.shortest)}
        return super().with_searched(values)

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: the joint's speed."""
        return Follows("speed")

    @property
    def stripped(self) -> Self:
        """A servo that holds for good while it sticks."""
        return replace(self, form=self.form.removeprefix("creeping_"), settling=None)

    @property
    def contains(self) -> tuple[str, ...]:
        """Keys of the lag that is part of it, where nobody simulated the servo's response."""
        return ("lag",) if "servo" in self.form and self.simulated is None else ()

    def at_work(self, scene: Scene, *, least: float = 0.1) -> bool:
        """Return whether a servo that gives way while it sticks also breaks loose, in so many of the rows that move.

        Args:
            least: share of the rows in motion in which what is called friction must slip.
        """
        if self.settling is None or self.coulomb is None:
            return True
        response, settling = self.constants()
        command = self.command(scene, response)
        stands = self._stand_off(scene)
        stands = stands + scene.lag("follows", command, response, held=True)[:, 0]
        moves = np.diff(command[:, 0]) != 0.0
        loose = np.abs(command[1:, 0] - stands[:-1]) > self.coulomb * settling / (settling - response)
        return bool(np.sum(loose & moves) >= least * np.sum(moves))

    def constants(self, *, least: float = 1.01) -> tuple[float, float]:
        """Return response and settling, s.

        Args:
            least: times slower than it follows a servo settles that sticks.
        """
        response = self.response if self.simulated is None else self.simulated
        assert response is not None, "proposed with one"
        return response, np.inf if self.settling is None else max(self.settling, least * response)

    def _servo(self, scene: Scene, v: Array) -> list[Array]:
        assert self.coulomb is not None, "proposed with one"
        out = [self._stand_off(scene)]
        if self.freedom:
            response, _ = self.constants()
            out.append(-scene.lag("viscous", v[:, None], response, held=True)[:, 0])
        return out

    @property
    def servo(self) -> tuple[object, ...]:
        """What its stand-off follows from."""
        return (self.joint, self.coulomb, *self.constants(), self.simulated is None)

    def command(self, scene: Scene, response: float) -> Array:
        """Return the command (N, 1) of the servo: the motion that was put in, or what makes a simulated servo move as it does."""
        at = scene.joint_index(self.joint)
        lead = 0.0 if self.simulated is None else response * scene.rates[0][:, at]
        return np.asarray((scene.q[:, at] + lead)[:, None])

    def _stand_off(self, scene: Scene) -> Array:
        """Return the stand-off (N,) from a servo that does not stick; kept in a scene, for it is asked for again."""
        kept, key = _kept(scene), self.servo
        with _KEEPING:
            if key in kept:
                kept.move_to_end(key)
                return kept[key]
        (out,) = _stand_offs(scene, [self])
        if scene.memory is None:
            with _KEEPING:
                kept[key] = out
                if len(kept) * len(out) > MOST_KEPT:
                    kept.popitem(last=False)
        return out


def _kept(scene: Scene) -> OrderedDict[object, Array]:
    """Return the stand-offs (N,) of servos that a scene keeps."""
    kept: OrderedDict[object, Array] = scene.__dict__.setdefault("_stand_offs", OrderedDict())
    return kept


def _stand_offs(scene: Scene, servos: Sequence[Friction]) -> list[Array]:
    """Return what each servo that sticks does (N,) beside one that does not."""
    response, settling = np.transpose([one.constants() for one in servos])
    # Many differ in their friction alone.
    alike = [(one.joint, float(each), one.simulated is None) for one, each in zip(servos, response, strict=True)]
    told = {key: one.command(scene, key[1]) for key, one in dict(zip(alike, servos, strict=True)).items()}
    follows = {key: scene.lag("follows", command, key[1], held=True)[:, 0] for key, command in told.items()}
    command = np.concatenate([told[key] for key in alike], axis=1)
    first = command[[part.start for part in scene.segments]]
    known = [scene.resting(f"joint.{one.joint}.position") for one in servos]
    start = np.stack([x if at is None else at[:, 0] for x, at in zip(first.T, known, strict=True)], axis=1)
    band = np.array([one.coulomb for one in servos], dtype=float)
    sticks = scene.servo("servo", command, band, response, settling, start)
    return [stands - follows[key] for key, stands in zip(alike, sticks.T, strict=True)]


def _is_effort(scene: Scene) -> bool:
    return scene.observations.predict == "effort"


def _place(scene: Scene, joint: str) -> int:
    return next(i for i, name in enumerate(scene.channels) if joint_of(name) == joint)


@dataclass(frozen=True)
class TorqueRipple(Effect):
    """A force periodic in joint position: r = a sin(n q) + b cos(n q), n cycles times 2 pi per rad or m.

    Of a joint's position the error of a gear or an encoder: the wave generator of a harmonic drive twice in each turn of the
    motor, an eccentric disk once in its own. Visible over several periods. Confused with vibration at constant speed and, for
    small n, with cable_drag.
    """

    PREDICTS: ClassVar = frozenset({"effort", "position"})

    KEY = "torque_ripple"
    SAYS = "a force, or an error of a reading, periodic in the joint's position"
    KNOWN_BY = "it repeats with the joint's position, at any speed"
    HEAD = ("wave_number",)
    RMS_TOLD = True
    ALIKE: ClassVar = {"cable_drag": "over less than one period a ripple is a spring"}
    SIDE_BY_SIDE = True
    SEARCHED: ClassVar = {"wave_number": Searched(0.1, 1e5, "rad/rad or rad/m")}
    joint: str
    wave_number: float
    of: str = "effort"

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield nothing on a fixed grid: the wave number is sought in the residual."""
        return iter(())

    @property
    def remark(self) -> str:
        """A sentence on what it is of a position."""
        return (
            ""
            if self.of == "effort"
            else "Of a position it is the error of a gear or an encoder, the same in each turn."
        )

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the amplitudes of sine and cosine."""
        unit = scene.units[_place(scene, self.joint)]
        return Parameter("sine", unit), Parameter("cosine", unit)

    def follows(self, scene: Scene, channel: int) -> Follows | None:
        """Return what it follows: the joint, periodically."""
        period = 2.0 * np.pi / self.wave_number
        return Follows("position", self.joint, period) if self.joint in scene.joint_names else None

    def doubt(self, scene: Scene) -> float:
        """Return half a period over the whole way of the joint: beyond it the fit has the next hump."""
        reach = float(np.ptp(scene.q[:, scene.joint_index(self.joint)]))
        return 1.0 + np.pi / max(reach * self.wave_number, 1.0)

    def columns(self, scene: Scene) -> Columns:
        """Return sine and cosine of the joint's position."""
        phase = self.wave_number * scene.q[:, scene.joint_index(self.joint)]
        return in_channel(_place(scene, self.joint), scene.seen(np.stack([np.sin(phase), np.cos(phase)], axis=-1)).T)
