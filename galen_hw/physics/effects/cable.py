"""A cable or hose: along one joint, as a spring that is linear in what is unknown, and as the tendon that it is."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns, in_all, in_channel
from galen_hw.physics.effects.parameters import Parameter
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.joint import EffortScene
from galen_hw.spatial import Array, skew

FARTHEST_ANCHOR: Final = 10.0
FARTHEST_CLIP: Final = 1.0
"""m, from the base and from the sensor or the last link's origin: no cable of an arm hangs further away."""
TENDON: Final = (
    Parameter("stiffness", "N/m", 0.0),
    *(Parameter(f"anchor_{a}", "m", furthest=FARTHEST_ANCHOR) for a in "xyz"),
    Parameter("rest_length", "m", 0.0, furthest=FARTHEST_ANCHOR),
    *(Parameter(f"clip_{a}", "m", furthest=FARTHEST_CLIP) for a in "xyz"),
)
LOOSE: Final = ("spring", "pull")
"""Forms with more parameters than a cable has."""
DRY: Final = (Parameter("dry_friction", "N", 0.0),)
EYE: Final = (Parameter("eye_friction", "N", 0.0), Parameter("stroke", "m", 1e-5, furthest=0.1))


@dataclass(frozen=True)
class CableDrag(Effect):
    """A cable or hose pulls.

    "spring": from a point of the sensor's body (or the last link, in efforts) to a point of the base, f = R^T (F0 - k p), torque
    c x f for an unknown lever c (linear relaxation: 15 numbers); "pull": the same without a stiffness; "tendon": from a clip c
    on the body to an anchor a on the base, of length l = |a - p - R c|, which pulls with k (l - l0) and goes slack below l0;
    "tendon_dry": the same in a conduit whose friction holds the pull back until the spring has overcome it (a play);
    "tendon_eye": the same through an eye that rubs, whose friction adds to the pull while the cable is drawn out and takes from
    it while it goes back, f (l - P_s[l]) / s with the stroke s over which it takes hold (Dahl 1968);
    "joint": one channel along with one joint, r = k q_j, with the cable's own dry friction r = k q_j + c s(dq_j) in "joint_dry".

    A cable that is tied to the arm itself has its far end on the link that the joint `anchored` moves, in whose frame the anchor
    then is; in efforts it may be clipped to the link that the joint `clipped` moves instead of the last.

    Visible when the arm moves far. Confused with drift where poses are ordered, with payload and base_tilt, and
    with hysteresis when it rubs.
    """

    KEY = "cable_drag"
    SAYS = "a cable or hose pulls, depending on where the arm is"
    KNOWN_BY = "it depends on the arm's position and not on the clock"
    CONFIRMED_BY = "repeat the poses in random order with the cable unplugged"
    HEAD = ("stiffness", "dry_friction", "eye_friction")
    REMOVED_BY = "repeat the motion with the cable unplugged or held slack"
    MIMICS_RIGID = True
    FLEXIBLE = True
    PROVES = True
    form: str
    channel: str = ""
    joint: str = ""
    transition: float = 1.0
    anchored: str = ""
    clipped: str = ""

    @classmethod
    def propose(cls, scene: Scene, *, near: int = 2) -> Iterator[Self]:
        """Yield the spring for wrenches; single channels and joints for wrenches and efforts. A tendon is sought from its spring.

        Args:
            near: links before the sensor's own to which its cable may be tied.
        """
        group = scene.observations.predict
        if group == "wrench" and scene.belief.robot is not None:
            yield cls("spring")
            yield cls("pull")
            yield from (cls("spring", anchored=joint) for joint in _carriers(scene)[-near:])
        if isinstance(scene, EffortScene) and scene.link("") is not None:
            yield cls("spring")
            yield from (cls("spring", clipped=joint) for joint in _carriers(scene))
        if group not in ("wrench", "effort"):
            return
        for joint in scene.moved:
            speed = float(np.nanstd(scene.rates[0][:, scene.joint_index(joint)]))
            for channel in scene.channels:
                if group == "effort" and joint_of(channel) != joint:
                    continue
                yield cls("joint", channel, joint)
                if scene.clock and speed > 0.0 and group == "wrench":
                    yield cls("joint_dry", channel, joint, 0.03 * speed)

    @property
    def freedom(self) -> int | None:
        """Number of physical parameters: stiffness, a point of the base and a point of the body; or a pull and its point."""
        return {"spring": 7, "pull": 6}.get(self.form)

    @property
    def remark(self) -> str:
        """What it is tied or clipped to, in whose frame anchor and clip are told."""
        ends = []
        if self.anchored:
            ends.append(f"its far end is tied to the link that {self.anchored} moves, and told in that link's frame")
        if self.clipped:
            ends.append(f"it is clipped to the link that {self.clipped} moves, and told in that link's frame")
        text = "; ".join(ends)
        return f"{text[:1].upper()}{text[1:]}." if text else ""

    @property
    def loose(self) -> bool:
        """Whether it is a spring or pull, which have more parameters than a cable has."""
        return self.form in LOOSE

    @property
    def relaxed(self) -> Self:
        """The spring that stands for the tendon, linear in its parameters."""
        return replace(self, form="spring") if self.curved else self

    @property
    def curved(self) -> bool:
        """Whether it is a tendon, whose slope at zero says little."""
        return self.form.startswith("tendon")

    def strides(self, scene: Scene, theta: Array) -> Array:
        """Return a ten-thousandth of the stiffness (of 1 N/m at least) and of how it rubs, a tenth of a millimetre."""
        if not self.curved:
            return super().strides(scene, theta)
        return np.array([1e-4 * max(abs(theta[0]), 1.0), *7 * [1e-4], *(1e-4 * abs(theta[8:])).clip(1e-6)])

    def known(self, theta: Array, spread: Array) -> bool:
        """Return whether it surely pulls, by its parameters (k,) and their standard deviations (k,).

        What turns without a force, or pulls nobody knows how much from nobody knows where, is no cable: a tendon must be stiffer
        than its own error, and of a spring's or a pull's forces one must be there by three errors.
        """
        if not self.loose:
            return not self.curved or bool(abs(theta[0]) >= spread[0])
        forces = slice(0, 4 if self.form == "spring" else 3)
        return bool(np.any(np.abs(theta[forces]) >= 3.0 * spread[forces]))

    def possible(self, scene: Scene, theta: Array, spread: Array) -> bool:
        """Return whether it pulls: a taut cable pulls the harder the further it is drawn, whichever way."""
        return self.form != "spring" or bool(theta[0] >= -3.0 * spread[0])

    def patches(self, others: Sequence[Effect]) -> bool:
        """Return whether it only patches others: one channel of a wrench with one joint, beside a tendon."""
        tendons = [other for other in others if isinstance(other, CableDrag) and other.curved]
        return bool(self.joint) and joint_of(self.channel) == "" and bool(tendons)

    @property
    def joints(self) -> tuple[str, ...]:
        """Where the arm must move for it to show."""
        return (self.joint,) if self.joint else ()

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return stiffness, pulls and levers; of a tendon its anchor in the base, and its clip on sensor or link."""
        if self.curved:
            return TENDON + {"tendon_dry": DRY, "tendon_eye": EYE}.get(self.form, ())
        if self.form.startswith("joint"):
            unit = scene.units[scene.channels.index(self.channel)]
            stiffness = Parameter("stiffness", f"{unit}/(rad or m)")
            return (stiffness,) if self.form == "joint" else (stiffness, Parameter("dry_friction", unit))
        pulls = [Parameter(f"pull_{a}", "N") for a in "xyz"]
        if self.form == "pull":
            return tuple(pulls + [Parameter(f"torque_{i}{j}", "N m") for i in "xyz" for j in "xyz"])
        levers = [Parameter(f"torque_{i}{j}", "N m") for i in "xyz" for j in "xyz"]
        arms = tuple(Parameter(f"stiffness_lever_{a}", "N") for a in "xyz")
        turned = tuple(Parameter(f"turned_lever_{a}", "N") for a in "xyz")
        more = turned if isinstance(scene, EffortScene) else ()
        return (Parameter("stiffness", "N/m"), *pulls, *arms, *levers, *more)

    def columns(self, scene: Scene) -> Columns:
        """Return positions of the joint, or pulls along the base's axes seen from the sensor."""
        if self.form.startswith("joint"):
            place, joint = scene.channels.index(self.channel), scene.joint_index(self.joint)
            q = scene.q[:, joint]
            rubs = [] if self.form == "joint" else [np.tanh(scene.rates[0][:, joint] / self.transition)]
            return in_channel(place, [q, *(scene.seen(rub[:, None])[:, 0] for rub in rubs)])
        if self.curved:
            return self._tangent_at_nothing(scene)
        if isinstance(scene, EffortScene):
            return self._in_efforts(scene)
        T = scene.sensor_in(self.anchored)  # type: ignore[attr-defined]
        Rt = np.swapaxes(T[:, :3, :3], 1, 2)
        p = np.einsum("nij,nj->ni", Rt, T[:, :3, 3])
        levers = skew(np.eye(3))
        out = np.zeros((len(scene), 6, 16))
        out[:, :3, 0], out[:, :3, 1:4] = -p, Rt
        out[:, 3:, 4:7] = -np.einsum("iab,nb->nai", levers, p)
        out[:, 3:, 7:] = np.einsum("iab,nbj->naij", levers, Rt).reshape(-1, 3, 9)
        if self.form == "pull":
            out = out[:, :, [1, 2, 3, *range(7, 16)]]
        return Columns(tuple(range(6)), out)

    def exact(self, scene: Scene, theta: Array) -> Array | None:
        """Return the pull of a tendon."""
        if not self.curved:
            return None
        R, p, answer = self._carrier(scene)
        lever, span, length = _stretched(R, p, theta)
        tension = abs(theta[0]) * np.maximum(length - theta[4], 0.0)
        if self.form == "tendon_dry":
            tension = np.maximum(scene.play("conduit", tension[:, None], abs(theta[8]))[:, 0], 0.0)
        if self.form == "tendon_eye":
            stroke = max(abs(theta[9]), EYE[1].low)
            held = (length - scene.play("eye", length[:, None], stroke)[:, 0]) / stroke
            # A cable that hangs loose is not drawn through anything.
            tension = np.maximum(tension + abs(theta[8]) * held * (tension > 0.0), 0.0)
        tension *= np.sign(theta[0])
        force = span * (tension / length)
        if answer is not None:
            wrench = np.concatenate([force, np.cross(lever, force, axis=0)])
            return np.asarray(np.einsum("cin,in->cn", answer, wrench).T)
        felt = (R * force[:, None]).sum(axis=0)
        return np.concatenate([felt, np.cross(theta[5:8], felt, axis=0)]).T

    def starts(self, scene: Scene, theta: Array) -> list[tuple[Effect, Array]]:
        """Return of a spring tendons that pull about as it does; of a tendon the same without what rubs; of a pull none."""
        tendon = replace(self, form="tendon")
        if self.curved:
            return [(tendon, theta[: len(TENDON)])]
        return [(tendon, one) for one in self.tendons(scene, theta)] if self.form == "spring" else []

    def richer_starts(self, scene: Scene, theta: Array) -> Iterator[list[tuple[Effect, Array]]]:
        """Yield the tendons in a conduit, and through an eye."""
        for form, rubbing in self.rubbing(scene, theta).items() if scene.clock else ():
            if rubbing:
                yield [(replace(self, form=form), one) for one in rubbing]

    def tendons(self, scene: Scene, theta: Array, *, lengths: tuple[float, ...] = (0.1, 0.3, 1.0)) -> list[Array]:
        """Return parameters (8,) of tendons that pull about as this spring does with its parameters theta (k,).

        Args:
            lengths: m, of tendons that may do what a spring does.
        """
        R, p = (x.mean(axis=-1) for x in self._carrier(scene)[:2])
        stiffness, constant, of_stiffness, of_constant = theta[0], theta[1:4], theta[4:7], theta[7:16]
        # One lever stands in twelve numbers.
        known = of_stiffness * stiffness + of_constant.reshape(3, 3) @ constant
        clip = known / max(stiffness**2 + float(constant @ constant), 1e-300)
        pull = constant - stiffness * p
        tension = float(np.linalg.norm(pull))
        out = []
        for length in lengths if tension > 0.0 else ():
            stiff = max(stiffness, tension / length)
            anchor = p + R @ clip + pull / tension * length
            out.append(np.array([stiff, *anchor, length - tension / stiff, *clip]))
        return out

    def rubbing(
        self,
        scene: Scene,
        theta: Array,
        *,
        strokes: tuple[float, ...] = (0.02, 0.2),
        shares: tuple[float, ...] = (0.2, 0.7),
    ) -> dict[str, list[Array]]:
        """Return by form the parameters of tendons as this one is with its parameters theta (8,), that rub little or much.

        Args:
            strokes: where the search for an eye's stroke begins, of the standard deviation of the length.
            shares: friction of a conduit where the search for it begins, of the standard deviation of the
                pull.
        """
        R, p, _ = self._carrier(scene)
        length = _stretched(R, p, theta)[2]
        swing, reach = float(np.std(theta[0] * np.maximum(length - theta[4], 0.0))), float(np.std(length))
        frictions = [share * swing for share in shares] if swing > 0.0 else []
        return {
            "tendon_dry": [np.append(theta, friction) for friction in frictions],
            "tendon_eye": [np.append(theta, (f, share * reach)) for f in frictions for share in strokes],
        }

    def _carrier(self, scene: Scene) -> tuple[Array, Array, Array | None]:
        """Return of the body that it pulls orientation (3, 3, N), position (3, N), efforts (C, 6, N) per wrench (None: felt)."""
        if isinstance(scene, EffortScene):
            return scene.carrier(self.clipped)
        # Row after row in memory: four times as fast to work with.
        whole = np.ascontiguousarray(scene.sensor_in(self.anchored)[:, :3].transpose(1, 2, 0))  # type: ignore[attr-defined]
        return whole[:, :3], whole[:, 3], None

    def _tangent_at_nothing(self, scene: Scene) -> Columns:
        """Return the slope at zero stiffness, where it does nothing wherever it is: one from origin to origin, else none."""
        count = len(self.parameters(scene))
        first = self.exact(scene, np.eye(count)[0])
        assert first is not None, "only a tendon is asked"
        values = np.zeros((len(scene), len(scene.channels), count))
        values[:, :, 0] = first
        return Columns(tuple(range(len(scene.channels))), values)

    def _in_efforts(self, scene: "EffortScene") -> Columns:
        """Return the same spring on a link, by virtual work: stiffness, pulls, and what an unknown lever adds."""
        known = scene.link(self.clipped)
        assert known is not None, "proposed only with a URDF"
        pose, answer = known
        R, p = pose[:, :3, :3], pose[:, :3, 3]
        push, turn = answer[:, :, :3], answer[:, :, 3:]

        def of(ports: Array, vectors: Array) -> Array:
            return np.asarray(np.einsum("nci,ni->nc", ports, vectors))

        axes = [R[:, :, i] for i in range(3)]
        out = [of(push, -p), *(push[:, :, i] for i in range(3))]
        out += [of(turn, np.cross(a, -p)) for a in axes]
        out += [of(turn, np.cross(a, np.eye(3)[j])) for a in axes for j in range(3)]
        out += [of(push, -a) for a in axes]
        return in_all(out, len(scene.channels))


def _carriers(scene: Scene) -> tuple[str, ...]:
    """Return joints whose links move here and beyond which the arm moves too, the base's first; one of a few together."""
    robot, moved = scene.belief.robot, set(scene.moved)
    links = () if robot is None else tuple(joints for joints in robot.chain if moved.intersection(joints))
    return tuple(joints[-1] for joints in links[:-1])


def _stretched(R: Array, p: Array, theta: Array, *, least: float = 1e-6) -> tuple[Array, Array, Array]:
    """Return of a tendon the way from the body's origin to the clip (3, N), from there to the anchor (3, N), and its length (N,).

    Args:
        least: m; a shorter tendon has no direction.
    """
    lever = (R * theta[5:8, None]).sum(axis=1)
    span = theta[1:4, None] - p - lever
    return lever, span, np.maximum(np.sqrt((span**2).sum(axis=0)), least)
