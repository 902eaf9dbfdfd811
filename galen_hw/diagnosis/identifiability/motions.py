"""Candidate recordings: joint motions of this robot within the range that it has shown.

Each recipe has a name, a sentence that an operator can follow, its length, and its stretches of motion.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from galen_hw.physics.effects.registry import kinds
from galen_hw.physics.rigid import Body
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Means:
    """Equipment that is available beside the robot.

    Args:
        mass: kg of a known weight that is hung on the tool beside its own; force: N of a known weight on the tip.
        warming: K between a cold and a warm machine.
        handling: minutes for a change of tool, a plug, a weight; longest: minutes, what takes longer is no advice.
        rows: on which a motion is simulated.
    """

    mass: float = 0.2
    force: float = 10.0
    warming: float = 10.0
    handling: float = 2.0
    longest: float = 180.0
    rows: int = 900


MEANS: Final = Means()


@dataclass(frozen=True)
class Part:
    """A stretch of motion.

    Args:
        time: (N,) s from the start of the recipe, or the row's number without a clock.
        q: (N, n) joint positions.
        tool: another body on the sensor; force: (N, 3) known force on the tip, N; warmth: (N,) 0 cold to 1 warm.
        without: keys of effects that are taken away here (the cable unplugged).
    """

    time: Array
    q: Array
    tool: Body | None = None
    force: Array | None = None
    warmth: Array | None = None
    without: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Recipe:
    """One recording that could be made.

    Args:
        name: short; says: an order that an operator can follow.
        minutes: with handling; parts: stretches of motion, one after the other.
        keys: effects that it is meant for; empty: any.
        again: it gains by being repeated.
    """

    name: str
    says: str
    minutes: float
    parts: tuple[Part, ...]
    keys: frozenset[str] = frozenset()
    again: bool = True


@dataclass(frozen=True)
class Room:
    """What the robot has shown that it can do.

    Args:
        joints: that moved; index: their places; q0: (n,) median pose.
        low, high, speed: (n,) range, rad or m, and usual top speed.
        step: least time between rows, s.
        ramp: (n,) time in which it usually comes to top speed, s.
    """

    joints: tuple[str, ...]
    index: tuple[int, ...]
    q0: Array
    low: Array
    high: Array
    speed: Array
    step: float
    ramp: Array


def room_of(scene: Scene, step: float) -> Room:
    """Return the range of motion that the recording shows."""
    index = tuple(scene.joint_index(j) for j in scene.moved)
    q = np.where(np.isfinite(scene.q), scene.q, 0.0)
    speed, ramp = np.ones(q.shape[1]), np.zeros(q.shape[1])
    if scene.clock:
        speed, quickest = (np.quantile(np.abs(rate), 0.95, axis=0) for rate in scene.rates)
        ramp = np.divide(speed, quickest, out=ramp, where=quickest > 0.0)
    return Room(scene.moved, index, np.median(q, axis=0), q.min(axis=0), q.max(axis=0), speed, step, ramp)


def recipes(scene: Scene, step: float, joints: tuple[str, ...]) -> Iterator[Recipe]:
    """Yield all recipes; sweeps for the named joints that moved, else for every one (at most five).

    Args:
        scene: the recording; step: s between its rows as they were diagnosed.
    """
    room = room_of(scene, step)
    if not room.joints:
        return
    if scene.clock:
        for joint in [j for j in joints if j in room.joints] or room.joints[:5]:
            yield from _sweeps(scene, room, joint)
        yield _still(room)
    path = _path(scene, room)
    yield _reversed(path, clock=scene.clock)
    yield _poses(room, clock=scene.clock)
    yield from _handled(scene, room, path)


def _sweeps(scene: Scene, room: Room, joint: str) -> Iterator[Recipe]:
    """Yield sweeps of one joint: slowly, by sizes, by speeds, with quick starts, with long rests."""
    j, unit = scene.joint_index(joint), scene.joint_units(joint)[0]
    low, high, top = float(room.low[j]), float(room.high[j]), float(room.speed[j])
    if not top > 0.0:
        return
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    between = f"{_number(low, unit)} and {_number(high, unit)}"
    slow = max(top / 8.0, 2.0 * half / 40.0)
    ends = [low, low, high, high] * 3
    yield _one(
        room,
        f"reverse slowly at both ends of {joint}",
        f"move {joint} slowly ({_number(slow, unit + '/s')}) between {between}, and rest 5 s at each end",
        j,
        ends,
        slow,
        5.0,
    )
    sizes = [middle + s * half * a for a in (1.0, 0.5, 0.2, 0.08) for s in (1.0, -1.0, 1.0, -1.0)]
    yield _one(
        room,
        f"large and small reversals of {joint}",
        f"move {joint} to and fro about {_number(middle, unit)} with ever smaller reversals, from {_number(half, unit)} "
        f"down to {_number(0.08 * half, unit)}, slowly",
        j,
        sizes,
        slow * 2.0,
        0.0,
    )
    stairs = [_leg([low, high, low, high, low], share * top, 1.0) for share in (0.08, 0.25, 0.6, 1.0)]
    yield _joined(
        room,
        f"speed staircase of {joint}",
        f"move {joint} to and fro between {between} at four constant speeds, {_number(0.08 * top, unit + '/s')} to "
        f"{_number(top, unit + '/s')}",
        j,
        stairs,
    )
    yield _one(
        room,
        f"quick starts of {joint}",
        f"move {joint} by {_number(0.3 * half, unit)} to and fro with quick starts and stops, resting 1 s between",
        j,
        [middle + 0.15 * half * s for s in (1.0, -1.0) * 12],
        1.5 * top,
        1.0,
    )
    yield _one(
        room,
        f"long rests at both ends of {joint}",
        f"move {joint} quickly between {between} and rest a minute at each end, four times",
        j,
        [low, high] * 2,
        top,
        60.0,
    )


def _leg(stops: list[float], speed: float, rest: float) -> tuple[Array, Array]:
    """Return the corners of a path of one joint: times and positions."""
    t, x = [0.0], [stops[0]]
    for a, b in itertools.pairwise(stops):
        if rest > 0.0:
            t, x = [*t, t[-1] + rest], [*x, a]
        t, x = [*t, t[-1] + max(abs(b - a) / speed, 1e-3)], [*x, b]
    return np.array([*t, t[-1] + max(rest, 1e-3)]), np.array([*x, stops[-1]])


def _one(room: Room, name: str, says: str, j: int, stops: list[float], speed: float, rest: float) -> Recipe:
    return _joined(room, name, says, j, [_leg(stops, speed, rest)])


def _joined(room: Room, name: str, says: str, j: int, legs: list[tuple[Array, Array]]) -> Recipe:
    """Return one recipe of the legs after one another, on a grid no finer than the recording's rows."""
    t, x = legs[0]
    for more, y in legs[1:]:
        t, x = np.concatenate([t, t[-1] + 1e-3 + more]), np.concatenate([x, y])
    time = _grid(float(t[-1]), room.step)
    q = np.tile(room.q0, (len(time), 1))
    q[:, j] = _ramped(np.interp(time, t, x), time, float(room.ramp[j]))
    return Recipe(name, says, float(t[-1]) / 60.0, (Part(time, q),))


def _ramped(x: Array, time: Array, ramp: float) -> Array:
    """Return a path (N,) of straight legs with corners rounded: speeds change evenly within `ramp` (s), as the robot's did.

    Differentiated as it is, a corner has an acceleration of the speed over the time between two rows: of the grid, not the robot.
    """
    rows = max(round(ramp / float(time[1] - time[0])), 1) if len(time) > 1 else 1
    return np.asarray(uniform_filter1d(x, rows, mode="nearest"))


def _grid(length: float, step: float) -> Array:
    return np.arange(0.0, length, max(step, length / MEANS.rows))


def _still(room: Room) -> Recipe:
    time = _grid(600.0, room.step)
    return Recipe("hold still for 10 min", "hold the arm still for 10 min", 10.0, (Part(time, _at(room, time)),))


def _at(room: Room, time: Array) -> Array:
    return np.tile(room.q0, (len(time), 1))


def _path(scene: Scene, room: Room) -> Part:
    """Return the recording's own motion, thinned."""
    rows = np.unique(np.linspace(0, len(scene) - 1, min(len(scene), MEANS.rows)).astype(int))
    return Part(scene.time[rows] - scene.time[rows[0]], np.where(np.isfinite(scene.q[rows]), scene.q[rows], room.q0))


def _length(part: Part, *, clock: bool) -> float:
    """Return the length of a part in minutes; four poses a minute where only their order is known."""
    return float(np.ptp(part.time)) / 60.0 if clock else len(part.time) / 4.0


def _after(part: Part, other: Part) -> Part:
    """Return the other part, started where this one ends."""
    step = float(part.time[-1] - part.time[-2])
    return replace(other, time=part.time[-1] + step + other.time - other.time[0])


def _reversed(path: Part, *, clock: bool) -> Recipe:
    back = replace(path, q=path.q[::-1])
    says = "run through the same poses, and then through them in reverse order"
    minutes = 2.0 * _length(path, clock=clock)
    return Recipe("same poses in reverse order", says, minutes, (path, _after(path, back)))


def _poses(room: Room, *, clock: bool) -> Recipe:
    """Return a recipe of sixty random poses, back to the same one after every eight, with seconds of rest in each."""
    rng, count = np.random.default_rng(3), 60
    q = np.tile(room.q0, (count, 1))
    for j in room.index:
        q[:, j] = room.low[j] + (room.high[j] - room.low[j]) * rng.random(count)
    q[::8] = room.q0
    says = "visit 60 poses in random order, returning to one and the same pose after every eighth"
    if not clock:
        return Recipe("random poses with returns", says, count / 4.0, (Part(np.arange(float(count)), q),))
    times = 5.0 * np.arange(count)
    corners = np.sort(np.concatenate([times, times + 3.0]))
    time = _grid(float(corners[-1]), room.step)
    legs = (np.interp(time, corners, np.repeat(q[:, j], 2)) for j in range(q.shape[1]))
    moved = np.stack([_ramped(x, time, ramp) for x, ramp in zip(legs, room.ramp.tolist(), strict=True)], axis=-1)
    return Recipe("random poses with returns", says + ", 3 s in each", float(time[-1]) / 60.0, (Part(time, moved),))


def _handled(scene: Scene, room: Room, path: Part) -> Iterator[Recipe]:
    """Yield recipes that need a hand: a second weight, a thermometer, a plug, free air, weights on the tip."""
    group, once = scene.observations.predict, _length(path, clock=scene.clock)
    if group == "wrench":
        tool = scene.belief.tool
        heavier = _with_weight(tool, MEANS.mass)
        says = f"repeat the motion with a known weight of {1e3 * MEANS.mass:.0f} g hung on the tool"
        yield Recipe("two payloads", says, 2 * once + MEANS.handling, (path, _after(path, replace(path, tool=heavier))))
    if scene.clock:
        time = _grid(1200.0, room.step)
        warmth = np.interp(time, [0.0, 200.0, 500.0, 700.0, 1000.0, 1200.0], [0.0, 1.0, 1.0, 0.2, 0.2, 0.9])
        says = "log the temperature at the sensor and warm and cool the machine twice within 20 min, at rest"
        yield Recipe(
            "log the temperature",
            says,
            20.0,
            (Part(time, _at(room, time), warmth=warmth),),
            frozenset(kind.KEY for kind in kinds() if kind.WARMS),
            again=False,
        )
    if group == "pose":
        yield _weights(room)
    for key, says in sorted((kind.KEY, kind.REMOVED_BY) for kind in kinds() if kind.REMOVED_BY):
        gone = _after(path, replace(path, without=frozenset((key,))))
        yield Recipe(says.split(" with ")[-1], says, once + MEANS.handling, (path, gone), frozenset((key,)))


def _with_weight(tool: Body, mass: float) -> Body:
    """Return the tool with a point mass hung 5 cm off its centre of mass, across the sensor's axis."""
    total = tool.mass + mass
    place = np.asarray(tool.com, dtype=float) + np.array([0.05, 0.0, 0.0])
    return Body(total, (tool.mass * np.asarray(tool.com) + mass * place) / total, np.asarray(tool.inertia))


def _weights(room: Room) -> Recipe:
    """Return a recipe of three poses with weights on the tip along three axes."""
    loads = [MEANS.force * share * axis for axis in -np.eye(3) for share in (0.0, 0.3, 0.6, 1.0)]
    rng = np.random.default_rng(5)
    time = _grid(len(loads) * 3 * 10.0, room.step)
    leg = np.minimum((time / 10.0).astype(int), len(loads) * 3 - 1)
    q = np.tile(room.q0, (3, 1))
    for j in room.index:
        q[:, j] = room.low[j] + (room.high[j] - room.low[j]) * rng.random(3)
    part = Part(time, q[leg // len(loads)], force=np.array(loads)[leg % len(loads)])
    says = f"in three poses pull the tip with known weights of up to {MEANS.force:.0f} N along three directions"
    return Recipe("known weights on the tip", says, float(time[-1]) / 60.0 + MEANS.handling, (part,))


def _number(x: float, unit: str) -> str:
    """Return a length or an angle in words."""
    if unit.startswith("rad"):
        return f"{np.degrees(x):.3g} deg{unit[3:]}"
    return f"{1e3 * x:.3g} mm{unit[1:]}"
