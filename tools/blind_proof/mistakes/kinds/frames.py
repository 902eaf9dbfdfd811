"""Frames and signs: permuted and mirrored axes, reactions, quaternions in another order, other frames, turned flanges."""

import numpy as np
from scipy.spatial.transform import Rotation

from galen_hw.tools.blind_proof.mistakes import turns
from galen_hw.tools.blind_proof.mistakes.kinds.kind import Kind, Made, Rng
from galen_hw.tools.blind_proof.mistakes.recording import FORCE, POINT, SENSOR, TORQUE, TURN, Array, Load, Recording

ABOUT = "frames"
WRENCH = ("arm6-wrench", "proof-wrench")
STATIC = ("static", "ft-kuka")


def _turned(rec: Recording, matrix: Array, names: tuple[str, ...]) -> None:
    rec.put(names, rec.get(names) @ matrix.T)


def _loads(rec: Recording, matrix: Array) -> list[Load]:
    """The load as it is in axes that are turned or mirrored by a matrix (3, 3)."""
    if rec.load is None:
        return []
    x, y, z = (matrix @ np.asarray(rec.load.com)).tolist()
    return [Load(rec.load.mass, (x, y, z))]


def _letters(matrix: Array) -> str:
    at = np.argmax(np.abs(matrix), axis=1)
    return " ".join(f"{'-' if matrix[k, i] < 0 else ''}{'xyz'[i]}" for k, i in enumerate(at))


def _permuted(rng: Rng, determinant: int) -> Array:
    """A permutation of axes with signs (3, 3), not the identity."""
    while True:
        out = np.zeros((3, 3))
        out[np.arange(3), rng.permutation(3)] = rng.choice([-1.0, 1.0], 3)
        if round(np.linalg.det(out)) == determinant and np.trace(out) < 2.5 and np.trace(out) > -2.5:
            return out


def permuted(rec: Recording, rng: Rng) -> Made:
    """Axes in another order, force and moment alike: a proper turn."""
    m = _permuted(rng, 1)
    _turned(rec, m, FORCE)
    _turned(rec, m, TORQUE)
    return Made(f"x y z are {_letters(m)}", {"sensor_mounting": turns.angle(m)}, _loads(rec, m))


def permuted_apart(rec: Recording, rng: Rng) -> Made:
    """Axes of the force alone, or of the moment alone, in another order."""
    m = _permuted(rng, int(rng.choice([-1, 1])))
    which = FORCE if rng.random() < 0.5 else TORQUE
    _turned(rec, m, which)
    return Made(f"x y z of the {which[0].split('.')[1]} are {_letters(m)}")


def mirrored(rec: Recording, rng: Rng) -> Made:
    """A left-handed wrench: one axis with the other sign, or two swapped, force and moment alike."""
    while True:
        m = _permuted(rng, -1)
        if np.count_nonzero(np.diag(m)) in {1, 3}:
            break
    _turned(rec, m, FORCE)
    _turned(rec, m, TORQUE)
    return Made(f"x y z are {_letters(m)}", {}, _loads(rec, m))


def reaction(rec: Recording, rng: Rng) -> Made:
    """What the tool bears and not what it does: the other sign, of force and moment."""
    del rng
    rec.put((*FORCE, *TORQUE), -rec.get((*FORCE, *TORQUE)))
    return Made("force and moment with the other sign")


def reaction_force(rec: Recording, rng: Rng) -> Made:
    """The force with the other sign."""
    del rng
    rec.put(FORCE, -rec.get(FORCE))
    return Made("force with the other sign")


def reaction_moment(rec: Recording, rng: Rng) -> Made:
    """The moment with the other sign."""
    del rng
    rec.put(TORQUE, -rec.get(TORQUE))
    return Made("moment with the other sign")


def _quat(rec: Recording) -> tuple[str, ...]:
    return SENSOR if SENSOR[0] in rec.columns else TURN


def w_first(rec: Recording, rng: Rng) -> Made:
    """Quaternions as w x y z in columns named x y z w."""
    del rng
    names = _quat(rec)
    rec.put(names, rec.get(names)[:, [3, 0, 1, 2]])
    return Made("w first")


def inverse(rec: Recording, rng: Rng) -> Made:
    """Quaternions from base to sensor, or to the tip."""
    del rng
    names = _quat(rec)
    rec.put(names, rec.get(names) * [-1, -1, -1, 1])
    return Made("the inverse turn")


def in_base_axes(rec: Recording, rng: Rng) -> Made:
    """The wrench in axes of the base, about the sensor's origin still; offsets are the sensor's, or were taken off before."""
    del rng
    turn = rec.turn if rec.turn is not None else turns.from_quat(rec.get(SENSOR))
    for names in (FORCE, TORQUE):
        rec.put(names, np.einsum("nij,nj->ni", turn, rec.get(names)))
    return Made("wrench in base axes")


def flange_turned(rec: Recording, rng: Rng) -> Made:
    """The sensor is turned on its flange by any angle about any axis."""
    axis = rng.normal(size=3) if rng.random() < 0.5 else np.eye(3)[rng.integers(3)]
    angle = rng.uniform(np.radians(12), np.radians(178)) * rng.choice([-1, 1])
    m = turns.about(axis, angle)
    _turned(rec, m, FORCE)
    _turned(rec, m, TORQUE)
    unit = axis / np.linalg.norm(axis)
    return Made(
        f"{np.degrees(angle):.1f} deg about {np.round(unit, 2).tolist()}",
        {"sensor_mounting": abs(float(angle))},
        _loads(rec, m),
    )


def gravity_along(rec: Recording, rng: Rng) -> Made:
    """The arm hangs on a wall, or anyhow: gravity along any direction of the base."""
    axis = rng.normal(size=3) * [1, 1, 0]
    angle = float(rng.choice([np.pi / 2, np.pi, rng.uniform(np.radians(15), np.radians(170))]))
    # As if the base were turned under the recording: what is known of the orientation is turned, the wrench stays.
    m = turns.about(axis, angle)
    turn = np.einsum("ij,njk->nik", m, turns.from_quat(rec.get(SENSOR)))
    rec.put(SENSOR, turns.to_quat(turn))
    return Made(f"gravity {np.degrees(angle):.1f} deg from down", {"base_tilt": angle})


def stated_gravity(rec: Recording, rng: Rng) -> Made:
    """recording.json has gravity along another axis than it was."""
    axis = int(rng.integers(3))
    wrong = np.zeros(3)
    wrong[axis] = 9.80665 * float(1.0 if axis == 2 else rng.choice([-1, 1]))
    rec.info["gravity"] = wrong.tolist()
    angle = float(np.arccos(np.clip(-wrong[2] / 9.80665, -1, 1)))
    return Made(f"gravity stated as {rec.info['gravity']}", {"base_tilt": angle})


def _points(rec: Recording) -> list[tuple[str, ...]]:
    """Groups of three columns that are points of a tracker."""
    if POINT[0] in rec.columns:
        return [POINT]
    heads = sorted({c.rsplit(".", 1)[0] for c in rec.columns if c.startswith("target.")})
    return [tuple(f"{h}.{a}" for a in "xyz") for h in heads]


def _in_tracker(rec: Recording, m: Array) -> None:
    """Points and turns in axes that are m times those that they were in; a mirror turns the turns as a tracker does."""
    for names in _points(rec):
        _turned(rec, m, names)
    if TURN[0] in rec.columns:
        turn = np.einsum("ij,njk,lk->nil", m, turns.from_quat(rec.get(TURN)), m)
        if round(np.linalg.det(m)) == 1:
            turn = np.einsum("ij,njk->nik", m, turns.from_quat(rec.get(TURN)))
        good = np.isfinite(turn).all(axis=(1, 2))
        quat = np.full((len(turn), 4), np.nan)
        quat[good] = Rotation.from_matrix(turn[good]).as_quat(canonical=True)
        rec.put(TURN, quat)


def tracker_left_handed(rec: Recording, rng: Rng) -> Made:
    """A tracker whose axes are left-handed: one with the other sign, or two swapped."""
    m = [np.diag([1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, 1.0]), np.eye(3)[[1, 0, 2]], np.eye(3)[[0, 2, 1]]]
    chosen = m[int(rng.integers(4))]
    _in_tracker(rec, chosen)
    return Made(f"axes of the tracker are {_letters(chosen)}")


def tracker_y_up(rec: Recording, rng: Rng) -> Made:
    """A tracker whose y is up, or whose x is: a proper turn of its axes."""
    m = np.array([[[1, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, 1], [1, 0, 0], [0, 1, 0]]], dtype=float)
    chosen = m[int(rng.integers(2))]
    _in_tracker(rec, chosen)
    return Made(f"axes of the tracker are {_letters(chosen)}")


MIRROR = (
    r"mirror|left.?hand|handed|(?:axis|axes|\b[xyz]\b).{0,80}(?:sign|swap|flip|revers|negat)"
    r"|(?:sign|swap|flip).{0,80}(?:axis|axes|\b[xyz]\b|F[xyz])"
)
ORDER = (
    r"permut|swap|order of (?:the )?(?:axes|columns)|turned.{0,60}(?:deg|rad|about)|mount"
    r"|(?:axis|axes).{0,80}(?:turned|order|exchang|another|differ|rotat|read like)|" + MIRROR
)
SIGN = r"\bsigns?\b|reaction|negat|revers|opposite|other way|negative mass|invert"
TILT = (
    r"gravity.{0,120}(?:tilt|turned|along|direction|points?|deg|wall|down|up)"
    r"|base.{0,60}(?:tilt|turned)|tilt|wall|upside"
)
MOUNT = r"mount|turned.{0,80}(?:deg|rad|about|link|flange)|(?:deg|rad).{0,60}turn"
QUAT_ORDER = r"w first|w,? ?x,? ?y,? ?z|order of.{0,40}quaternion|quaternion.{0,100}order|scalar first"
QUAT_INVERSE = r"invers|base to sensor|other way|conjugat|transpos"
BASE_AXES = r"base(?:'s)? (?:axes|frame)|axes of the base|(?:in|of) the (?:frame|axes) of the base|in the base"
TRACKER = (
    r"y.?up|tracker.{0,120}(?:axes|turned|frame|up|registr|rotat)|axes.{0,80}(?:turned|permut|order)"
    r"|(?:pose|position|target).{0,100}(?:turned|axes|frame)|base_?tilt|registration"
)

MOUNTING = frozenset({"sensor_mounting"})
# A whole turn of the sensor's x, y, z is a mounting; the joints of the Galen's wrist turn about two of its axes.
TILTED = frozenset({"base_tilt"})

QUATERNION = frozenset({"quaternion"})

KINDS = (
    Kind("permuted", ABOUT, "diagnose", WRENCH, permuted, (ORDER,), effects=MOUNTING),
    Kind("permuted_static", ABOUT, "calibrate", STATIC, permuted, (ORDER,)),
    Kind("permuted_apart", ABOUT, "diagnose", WRENCH, permuted_apart, (ORDER,)),
    Kind("permuted_apart_static", ABOUT, "calibrate", STATIC, permuted_apart, (ORDER,)),
    Kind("mirrored", ABOUT, "diagnose", WRENCH, mirrored, (MIRROR,)),
    Kind("mirrored_static", ABOUT, "calibrate", STATIC, mirrored, (MIRROR,)),
    Kind("reaction", ABOUT, "diagnose", WRENCH, reaction, (SIGN,)),
    Kind("reaction_static", ABOUT, "calibrate", STATIC, reaction, (SIGN,)),
    Kind("reaction_force", ABOUT, "diagnose", WRENCH, reaction_force, (SIGN,)),
    Kind("reaction_force_static", ABOUT, "calibrate", STATIC, reaction_force, (SIGN,)),
    Kind("reaction_moment", ABOUT, "diagnose", WRENCH, reaction_moment, (SIGN,)),
    Kind(
        "reaction_moment_static",
        ABOUT,
        "calibrate",
        ("static",),
        reaction_moment,
        (SIGN, r"com.{0,80}(?:named|tool)"),
        needs=frozenset({"tool"}),
    ),
    Kind("quaternion_w_first", ABOUT, "calibrate", STATIC, w_first, (QUAT_ORDER,), needs=QUATERNION),
    Kind("quaternion_inverse", ABOUT, "calibrate", STATIC, inverse, (QUAT_INVERSE,), needs=QUATERNION),
    Kind("pose_w_first", ABOUT, "diagnose", ("arm6-pose",), w_first, (QUAT_ORDER,)),
    Kind("pose_inverse", ABOUT, "diagnose", ("arm6-pose",), inverse, (QUAT_INVERSE,)),
    Kind("base_axes", ABOUT, "diagnose", ("arm6-wrench", "kuka"), in_base_axes, (BASE_AXES,)),
    Kind("base_axes_static", ABOUT, "calibrate", STATIC, in_base_axes, (BASE_AXES,)),
    Kind("flange_turned", ABOUT, "diagnose", WRENCH, flange_turned, (MOUNT,), effects=MOUNTING),
    Kind("flange_turned_static", ABOUT, "calibrate", STATIC, flange_turned, (MOUNT,)),
    Kind("gravity_static", ABOUT, "calibrate", STATIC, gravity_along, (TILT,), needs=QUATERNION),
    Kind(
        "gravity_stated",
        ABOUT,
        "diagnose",
        (*WRENCH, "arm6-effort", "proof-effort"),
        stated_gravity,
        (TILT,),
        effects=TILTED,
    ),
    Kind(
        "tracker_left_handed",
        ABOUT,
        "diagnose",
        ("arm6-pose", "proof-pose", "arm6-targets"),
        tracker_left_handed,
        (MIRROR,),
    ),
    Kind(
        "tracker_y_up",
        ABOUT,
        "diagnose",
        ("arm6-pose", "proof-pose", "arm6-targets"),
        tracker_y_up,
        (TRACKER,),
        effects=TILTED,
        silent=True,
    ),
)
