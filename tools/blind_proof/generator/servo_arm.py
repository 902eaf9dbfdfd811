"""The arm under servo, stepped in time so that what sticks stands still.

MuJoCo's own dry friction is a soft constraint: under any load, however small beside its limit, a joint creeps at about a
millisecond times the load over the inertia (1.06e-3 s with default settings), which within one rest is half the noise of this
arm's encoders. Here MuJoCo gives mass matrix, weight and inertial forces alone. Friction and the stops of play are impulses of
a time step, found together with the velocities at its end (Moreau 1988; Stewart and Trinkle 1996): a joint whose friction is
not at its limit has the velocity 0 exactly.
"""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S: Final = 0.005
ROUNDS: Final = 200
"""Of projections in a step at most; a few do, as each begins with the impulses of the last step."""
CLOSE: Final = 1e-11
"""N m s: change of every impulse in a round with which they are found."""


@dataclass
class Servo:
    """What drives and holds the joints, one entry a degree of freedom (n,).

    Args:
        kp, kv: gains of a position servo, N m/rad and N m s/rad; 0 where there is no motor.
        loss: dry friction, N m; damping: viscous friction, N m s/rad.
        low, high: stops, rad; infinite where there are none.
    """

    kp: Array
    kv: Array
    loss: Array
    damping: Array
    low: Array
    high: Array


class Stepper:
    """Steps a MuJoCo model without friction, limits and actuators of its own.

    Args:
        model: whose joints are all hinges or slides; servo: what acts on them; q: (n,) where they stand at the beginning.
    """

    def __init__(self, model: mujoco.MjModel, servo: Servo, q: Array) -> None:
        self.model, self.servo = model, servo
        self.data = mujoco.MjData(model)
        self.data.qpos[:] = q
        self._unit, self._mass = np.eye(model.nv), np.zeros((model.nv, model.nv))
        self._impulse: Array = np.zeros(model.nv)
        self._bounded = np.flatnonzero((servo.loss > 0.0) | np.isfinite(servo.low) | np.isfinite(servo.high)).tolist()

    @property
    def q(self) -> Array:
        """(n,) positions now."""
        return np.asarray(self.data.qpos)

    @property
    def rate(self) -> Array:
        """(n,) velocities at the end of the last step."""
        return np.asarray(self.data.qvel)

    def step(self, command: Array, h: float = STEP_S) -> None:
        """Move on by h seconds towards a command (n,), servo and damping taken at the end of the step (implicit Euler)."""
        data, s = self.data, self.servo
        mujoco.mj_fwdPosition(self.model, data)
        mujoco.mj_fwdVelocity(self.model, data)
        for column, unit in zip(
            self._mass, self._unit, strict=True
        ):  # mj_fullM takes other arguments from version to version
            mujoco.mj_mulM(self.model, data, column, unit)
        force = data.qfrc_passive - data.qfrc_bias
        force += s.kp * (command - data.qpos - h * data.qvel) - (s.kv + s.damping) * data.qvel
        inverse = np.linalg.inv(self._mass + np.diag(h * (s.kv + s.damping) + h * h * s.kp))
        rate = data.qvel + inverse @ (h * force)
        if self._bounded:
            rate = self._held(rate, inverse, h)
        data.qvel[:] = rate
        data.qpos[:] += h * rate

    def _held(self, free: Array, inverse: Array, h: float) -> Array:
        """Velocities (n,) at the end of a step that would be `free` (n,) without friction and stops.

        Impulses by projected Gauss-Seidel: each in turn is what takes its own joint to rest, or to its stop, within its bounds.
        """
        s, p, rate = self.servo, self._impulse, free + inverse @ self._impulse
        low, high = (s.low - self.data.qpos) / h, (s.high - self.data.qpos) / h
        target = np.zeros(len(p))
        for _ in range(ROUNDS):
            moved = 0.0
            for k in self._bounded:
                alone = rate[k] - inverse[k, k] * p[k]
                if s.loss[k] > 0.0:
                    new = min(max(-alone / inverse[k, k], -h * s.loss[k]), h * s.loss[k])
                else:
                    target[k] = min(max(alone, low[k]), high[k])
                    new = (target[k] - alone) / inverse[k, k]
                change, p[k] = new - p[k], new
                if change:
                    rate += inverse[:, k] * change
                    moved = max(moved, abs(change))
            if moved < CLOSE:
                break
        for k in self._bounded:
            if s.loss[k] > 0.0 and abs(p[k]) < h * s.loss[k]:
                rate[k] = 0.0
            elif p[k] != 0.0 and s.loss[k] <= 0.0:
                rate[k] = target[k]
        return np.asarray(rate)
