"""Generated robots that give: deflection sets of the MuJoCo arm, whose parameters the fit does not see."""

from dataclasses import dataclass

import numpy as np

from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.rigid import Body
from galen_hw.spatial import Array, rotation_exp
from galen_hw.tools.blind_proof.generator import pose, signal
from galen_hw.tools.blind_proof.generator.case import Case
from galen_hw.tools.blind_proof.generator.galen import BIAS_COM, BIAS_MASS, JOINTS, TOOLS, carriages
from galen_hw.tools.blind_proof.generator.motion import Path

RATE_HZ = 60.0
NOISE_M = 7e-5
FORCE_NOISE_N = 0.02
KINDS = ("hysteresis", "creep", "hardening", "play")
TURN_COMPLIANCE = (3.3e-3, 3.3e-2)
"""Of roll and tilt, rad/(N m): 0.1 to 1 mm/N at the tip, whose lever is about 0.17 m.

No record prints the Galen's stiffness, so two public figures bound the draw. An arm of today's stiff kind gives 1 mm
under 10 N (flexiv_rdk, issue 133). The report's best net was left with an error of 9.483 (no unit is printed): beside
a tracker's noise of 0.05 to 0.1 mm, and with hands that push some ten newtons, only millimetres make sense of it.
"""
LIFT_COMPLIANCE = (2e-5, 2e-4)
"""m/N: three carriages share what is along them, so that it gives less than a lever on one bearing."""
_WAY = ((0.0, 0.0), (0.8, 1.0), (2.8, 1.0), (4.2, -1.0), (6.2, -1.0), (7.0, 0.0), (9.0, 0.0))
"""One push: s and share of its force; both ways through zero, with dwells and a rest."""


COMES_S, STAYS_S = 3.0, 2.0
"""Before each set, unseen: the way from somewhere else, and a while at the place."""


@dataclass
class GivingRobot:
    """One robot and what is concealed in it.

    Args:
        comes_from_afar: before each set the arm comes from another place, and its friction remembers the tool's weight
            there; False: it begins relaxed.
    """

    seed: int
    tool: str
    give: pose.Give
    present: dict[str, bool]
    latency_s: float
    comes_from_afar: bool = True

    @classmethod
    def drawn(cls, seed: int) -> "GivingRobot":
        """Springs always; friction, creep, hardening and play each with even odds."""
        rng = np.random.default_rng([seed, 4])
        present = {kind: bool(rng.random() < 0.5) for kind in KINDS}
        give = pose.Give()
        # As likely between 0.1 and 0.2 mm/N as between 0.5 and 1: only the order of magnitude is known.
        ranges = (LIFT_COMPLIANCE, TURN_COMPLIANCE, TURN_COMPLIANCE)
        give.compliance = np.array([np.exp(rng.uniform(*np.log(r))) for r in ranges])
        if present["hysteresis"]:
            give.friction = rng.uniform(0.04, 0.15, 3) * np.array([12.0, 2.0, 2.0])
        if present["creep"]:
            give.creep, give.creep_tau_s = rng.uniform(0.06, 0.25, 3) * give.compliance, float(rng.uniform(1.0, 6.0))
        if present["hardening"]:
            give.hardening = float(rng.uniform(0.06, 0.25))
        if present["play"]:
            give.play[int(rng.integers(1, 3))] = rng.uniform(3e-4, 1e-3)
        tool = str(rng.choice(["pointer", "retractor"]))
        return cls(seed, tool, give, present, float(rng.uniform(0.0, 0.02)))

    def sets(
        self, count: int = 4, *, each: int = 2, day: int = 0, first: int = 0, again: int = 0
    ) -> list[DeflectionSet]:
        """`each` sets at every one of `count` configurations, numbered from `first`.

        Args:
            day: another one has its own registration; again: so many sets of each configuration lie before these.
        """
        return [
            self.recorded(
                self._place(first + k), f"set{first + k}{'abcd'[n]}-day{day}", [self.seed, 5, day, first + k, n]
            )
            for k in range(count)
            for n in range(again, again + each)
        ]

    def _place(self, k: int) -> Array:
        """Platform, roll and tilt of configuration k: a spread over the workspace, the same on every day."""
        rng = np.random.default_rng([self.seed, 6, k])
        roll = (-0.75, 0.7, 0.0, -0.35, 0.4, 0.9, -0.9, 0.2)[k % 8]
        tilt = (0.45, -0.4, 0.1, -0.5, 0.5, 0.2, -0.2, -0.1)[k % 8]
        return np.array([*rng.uniform(-0.06, 0.06, 3), roll + rng.uniform(-0.1, 0.1), tilt + rng.uniform(-0.1, 0.1)])

    def recorded(self, place: Array, name: str, seed: list[int]) -> DeflectionSet:
        """One set: pushes along the axes and askew at one place, tracked with noise and latency.

        Args:
            place: (5,) platform m, roll and tilt rad; seed: its third number is the day.
        """
        rng = np.random.default_rng(seed)
        force = pushes(rng)
        n = len(force)
        t = np.arange(n) / RATE_HZ
        case = Case("deflection", self.seed, "pose", "single", rate_hz=RATE_HZ)
        q = np.vstack([self._way(place, seed), np.tile(place, (n, 1))])
        path = Path(np.arange(len(q)) / RATE_HZ, q, np.zeros_like(q), np.zeros_like(q))
        before = len(q) - n
        loads = np.vstack([np.zeros((before, 3)), force])
        tip = pose.simulate(pose.PoseScene(case, path, loads, self.tool, self.give))[before:]
        seen = signal.delayed(t, self._registered(tip, seed[2]), self.latency_s)
        seen = seen + rng.normal(0.0, NOISE_M, (n, 3)) + rng.normal(0.0, 1e-4, 3)
        q = np.hstack([carriages(q[before:, :3]), q[before:, 3:]])
        columns = {"time": t} | {f"joint.{j}.position": q[:, i] for i, j in enumerate(JOINTS)}
        felt = force + rng.normal(0.0, FORCE_NOISE_N, force.shape)
        columns |= {f"applied.force.{a}": felt[:, i] for i, a in enumerate("xyz")}
        columns |= {f"pose.position.{a}": seen[:, i] for i, a in enumerate("xyz")}
        columns |= {f"covariate.true.{a}": tip[:, i] for i, a in enumerate("xyz")}
        return DeflectionSet.of(name, Observations("pose", columns, None, self.belief), tool=self.tool)

    def _way(self, place: Array, seed: list[int]) -> Array:
        """(N, 5) from somewhere in the workspace to the place, and a while there."""
        if not self.comes_from_afar:
            return np.zeros((0, 5))
        rng = np.random.default_rng([*seed, 8])
        origin = np.array([*rng.uniform(-0.06, 0.06, 3), rng.uniform(-1.0, 1.0), rng.uniform(-0.6, 0.6)])
        share = np.linspace(0.0, 1.0, round(COMES_S * RATE_HZ))[:, None]
        return np.vstack([origin + share * (place - origin), np.tile(place, (round(STAYS_S * RATE_HZ), 1))])

    def _registered(self, tip: Array, day: int) -> Array:
        """(N, 3) in the base as it was registered on that day: the first day's base is the one that counts."""
        if day == 0:
            return tip
        rng = np.random.default_rng([self.seed, 7, day])
        return np.asarray(tip @ rotation_exp(rng.normal(0.0, 5e-4, 3)).T + rng.normal(0.0, 3e-4, 3))

    @property
    def belief(self) -> Belief:
        """The nominal robot with the known tool."""
        t = TOOLS[self.tool]
        return Belief(
            robot=GalenRobot(),
            tool=Body(t.mass, np.array(t.com), np.diag(t.inertia)),
            tip=np.array(t.tip),
            bias_body=Body(BIAS_MASS, np.array(BIAS_COM)),
        )


def pushes(rng: np.random.Generator, largest_n: float = 15.0) -> Array:
    """(N, 3) forces of one set: two seconds of rest, then six pushes along axes and askew at several levels."""
    knots_t, knots_f, now = [0.0, 2.0], [np.zeros(3), np.zeros(3)], 2.0
    directions = [*np.eye(3)[rng.permutation(3)], *(d / np.linalg.norm(d) for d in rng.normal(size=(3, 3)))]
    for direction in directions:
        size = largest_n * rng.uniform(0.4, 1.0) * (1.0 if rng.random() < 0.5 else -1.0)
        for seconds, share in _WAY:
            knots_t.append(now + seconds + 1e-6)
            knots_f.append(share * size * direction)
        now += _WAY[-1][0]
    times = np.arange(round(now * RATE_HZ)) / RATE_HZ
    return np.stack([np.interp(times, knots_t, f) for f in np.array(knots_f).T], axis=1)
