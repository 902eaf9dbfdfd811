"""What is taken off each raw wrench, and how a change of it is blended in without a step."""

from collections.abc import Sequence
from math import hypot, isfinite
from typing import Any, Final

from galen_hw.clock import NS_PER_S
from galen_hw.config.tool_file import ToolFile, parse_tool
from galen_hw.kinematics import Robot
from galen_hw.messages import CompensationState, Vector3, WrenchRaw
from galen_hw.services.compensation.gravity_direction import Triple
from galen_hw.services.compensation.model import ZERO, CompensationModel, Six

NO_RESIDUAL = (0.0,) * 9
SEEN_SHARE: Final = 0.5
"""Of the tool's weight: less than that unexplained, and the tool hangs on the sensor; all of it is missing otherwise."""
UNFELT_N: Final = 0.1
"""N that no hand-over-hand control answers: a tool of less weight is not waited for."""


class Correction:
    """Prediction of the tool in hand, tare, contact point, and the blend from what was before.

    A change (tool, toggle, tare, contact) leaves a residual r: what was taken off before minus what is taken off now,
    at the sample of the change. Then r (1 - p) is taken off beside the new correction, p going from 0 to 1 along
    3 x^2 - 2 x^3, so that the output has neither a step nor a kink; a change within a change works the same way.

    Args:
        robot: that carries the sensor.
        enabled: whether the prediction is subtracted.
        blend_s: duration of a change, s.
    """

    def __init__(self, robot: Robot, *, enabled: bool, blend_s: float) -> None:
        self._robot = robot
        self._blend_ns = max(1, round(blend_s * NS_PER_S))
        self.enabled = enabled
        self.model: CompensationModel | None = None
        self.contact: Triple = (0.0, 0.0, 0.0)
        self.tare: Six = ZERO
        self.awaited = False
        """The sensor was zeroed, and what it read since then was never that of the tool in hand."""
        self.changed = True
        self._blending = False
        self._residual: tuple[float, ...] = NO_RESIDUAL
        self._from_ns = 0
        self._last: tuple[float, ...] = ()
        self.last_ns = 0
        self._tool_text = ""

    @property
    def active(self) -> bool:
        """A tool's prediction is being subtracted."""
        return self.enabled and self.model is not None

    @property
    def rests_on_zero(self) -> bool:
        """The prediction being subtracted is that of a sensor that was zeroed."""
        return self.enabled and self.model is not None and self.model.tool.zeroed_at is not None

    def use(self, tool: ToolFile | None) -> None:
        """Another tool in hand (None: none); the contact point becomes the tool's.

        Raises:
            UsageError: its file does not fit this robot; nothing has changed.
        """
        self.model = None if tool is None else CompensationModel(tool, self._robot)
        self._tool_text = "" if tool is None else tool.to_json()
        self.contact = (0.0, 0.0, 0.0) if tool is None else tool.contact_point
        self.changed = True

    def set(self, *, enabled: bool | None = None, tare: Six | None = None, contact: Triple | None = None) -> None:
        """Change what is given; it is blended in from the next sample on."""
        self.enabled = self.enabled if enabled is None else enabled
        self.tare = self.tare if tare is None else tare
        self.contact = self.contact if contact is None else contact
        self.changed = True

    def unzeroed(self, raw: WrenchRaw) -> bool:
        """The sensor's own offset is in its reading: neither zeroed nor tared away."""
        return raw.zeroings == 0 and self.tare == ZERO

    def holds_offset(self, raw: WrenchRaw) -> bool:
        """The sensor's own offset is in what is left: no calibration is subtracted whose bias was found with it."""
        return self.unzeroed(raw) and (not self.active or self.rests_on_zero)

    @property
    def unseen(self) -> bool:
        """What is left may lack the tool's weight, or hold it twice: zeroed, not seen since, and not tared."""
        return self.awaited and self.rests_on_zero and self.tare == ZERO

    def look_for_tool(self, raw: WrenchRaw, predicted: Six) -> bool:
        """Return whether this sample shows, for the first time since the sensor was zeroed, that the tool hangs on it.

        Zeroed with the tool on, a sensor misses its weight from then on in every pose, as it does while the tool is off.

        Args:
            predicted: (6,) N and N m, as `predict` has it.
        """
        if not self.awaited or self.model is None or not self.rests_on_zero:
            return False
        left = hypot(raw.force.x - predicted[0], raw.force.y - predicted[1], raw.force.z - predicted[2])
        self.awaited = not left <= max(SEEN_SHARE * self.model.weight, UNFELT_N)
        return not self.awaited

    def retare(self, tare: Six) -> None:
        """Another tare, at once: what came before it was of another zero, and blending would carry that on."""
        if self.tare != tare:
            self.tare, self._last, self.changed = tare, (), True

    def predict(self, q: Sequence[float], raw: WrenchRaw) -> Six:
        """Predicted wrench of a sample at these joint positions (in the model's order); zero when off."""
        if self.model is None or not self.enabled:
            return ZERO
        predicted = self.model.predict(q)
        return self.model.add_terms(predicted, q, raw) if self.model.terms else predicted

    def begin(self, t_ns: int, predicted: Six) -> None:
        """Start the blend of a change, at the first sample after it (its `t_ns` and prediction)."""
        self.changed = False
        now = self._total(predicted)
        residual = tuple([old - new for old, new in zip(self._last, now, strict=False)])
        self._blending = len(residual) == 9 and isfinite(sum(residual))
        self._residual = residual if self._blending else NO_RESIDUAL
        self._from_ns = t_ns

    def apply(self, t_ns: int, predicted: Six) -> tuple[tuple[float, ...], float]:
        """(what to take off: wrench (6), contact point (3); progress 0 to 1 of the blend) for a sample."""
        total, progress = self._total(predicted), 1.0
        if self._blending:
            progress = min(1.0, max(0.0, (t_ns - self._from_ns) / self._blend_ns))
            rest = 1.0 - progress * progress * (3.0 - 2.0 * progress)
            total = tuple([new + rest * r for new, r in zip(total, self._residual, strict=True)])
            self._blending = progress < 1.0
        self._last, self.last_ns = total, t_ns
        return total, progress

    def _total(self, predicted: Six) -> tuple[float, ...]:
        a, b, c, d, e, f = predicted
        u, v, w, x, y, z = self.tare
        return (a + u, b + v, c + w, d + x, e + y, f + z, *self.contact)

    def state(
        self, header: dict[str, Any], *, serial: str, problem: str, settings: str, samples: int
    ) -> CompensationState:
        """All of it as a message; it holds for the samples after the last one (`header` bears its time)."""
        return CompensationState(
            **header,
            valid=True,
            tool=self.model.name if self.model is not None else "",
            calibration=self.model.calibration if self.model is not None else "",
            enabled=self.enabled,
            sensor_serial=serial,
            problem=problem,
            tool_file=self._tool_text,
            settings=settings,
            contact=Vector3(*self.contact),
            tare=list(self.tare),
            residual=list(self._residual) if self._blending else [],
            blend_from_ns=self._from_ns,
            samples=samples,
            tool_awaited=self.awaited,
        )

    def restore(self, state: CompensationState) -> None:
        """Take over a recorded state, for a replay.

        Raises:
            UsageError: its tool's file cannot be read.
        """
        if state.tool_file != self._tool_text:
            self.use(parse_tool(state.tool_file, "compensation/state: tool_file") if state.tool_file else None)
        self.enabled, self.contact = state.enabled, (state.contact.x, state.contact.y, state.contact.z)
        self.tare = tuple(state.tare) if state.tare else ZERO  # type: ignore[assignment]
        self._residual = tuple(state.residual) if state.residual else NO_RESIDUAL
        self._from_ns, self._blending, self.changed = state.blend_from_ns, bool(state.residual), False
        self.awaited = state.tool_awaited
