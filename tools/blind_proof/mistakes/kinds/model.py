"""The model: a URDF that no machine can be, and two that are read though they are rare."""

import re

from galen_hw.tools.blind_proof.mistakes.kinds.kind import Kind, Made, Rng
from galen_hw.tools.blind_proof.mistakes.recording import Recording

ABOUT = "model"
INERTIAL = re.compile(r"<inertial>.*?</inertial>", re.DOTALL)
MASS = re.compile(r'(<mass\s+value=")([^"]+)(")')
INERTIA = re.compile(r'(i[xyz]{2}=")([^"]+)(")')


def _urdf(rec: Recording) -> tuple[str, str]:
    name = str(rec.info["robot"])
    return name, rec.files[name]


def no_masses(rec: Recording, rng: Rng) -> Made:
    """No link has inertial values, or all masses are zero."""
    name, text = _urdf(rec)
    if rng.random() < 0.5:
        rec.files[name] = INERTIAL.sub("", text)
        return Made("no <inertial> in the URDF")
    rec.files[name] = INERTIA.sub(r"\g<1>0\g<3>", MASS.sub(r"\g<1>0\g<3>", text))
    return Made("all masses and inertias are 0")


def _heavy(text: str) -> list[re.Match[str]]:
    """The inertial elements, greatest mass first."""
    found = [m for m in INERTIAL.finditer(text) if MASS.search(m.group())]
    return sorted(found, key=lambda m: -float(MASS.search(m.group()).group(2)))  # type: ignore[union-attr]


def one_missing(rec: Recording, rng: Rng) -> Made:
    """One of the two heaviest links has no inertial values."""
    name, text = _urdf(rec)
    out = _heavy(text)[int(rng.integers(2))]
    rec.files[name] = text[: out.start()] + text[out.end() :]
    return Made(f"no {out.group()[:90]}")


def _scaled(text: str, pattern: re.Pattern[str], by: float) -> str:
    return pattern.sub(lambda m: f"{m.group(1)}{float(m.group(2)) * by:.9g}{m.group(3)}", text)


def masses_scaled(rec: Recording, rng: Rng) -> Made:
    """All masses in grams, or in tonnes."""
    name, text = _urdf(rec)
    by = float(rng.choice([1e3, 1e-3]))
    rec.files[name] = _scaled(text, MASS, by)
    return Made(f"masses times {by:g}")


def inertias_scaled(rec: Recording, rng: Rng) -> Made:
    """All inertias in kg mm^2, or in g mm^2."""
    name, text = _urdf(rec)
    by = float(rng.choice([1e3, 1e6]))
    rec.files[name] = _scaled(text, INERTIA, by)
    return Made(f"inertias times {by:g}")


def no_body(rec: Recording, rng: Rng) -> Made:
    """A link's inertia breaks the triangle inequality, or is negative."""
    name, text = _urdf(rec)
    chosen = _heavy(text)[int(rng.integers(3))]
    by = float(rng.choice([5.0, -1.0]))
    spoiled = re.sub(
        r'(izz=")([^"]+)(")', lambda m: f"{m.group(1)}{float(m.group(2)) * by:.9g}{m.group(3)}", chosen.group()
    )
    rec.files[name] = text[: chosen.start()] + spoiled + text[chosen.end() :]
    return Made(f"izz times {by:g} in {chosen.group()[:90]}")


def no_sensor_link(rec: Recording, rng: Rng) -> Made:
    """recording.json names a sensor link that the URDF has not."""
    rec.info["sensor_link"] = str(rng.choice(["ft_sensor", "ft_link", "FT", "tool0"]))
    return Made(f"sensor_link {rec.info['sensor_link']}")


def joint_without_column(rec: Recording, rng: Rng) -> Made:
    """The table lacks the columns of one joint that the URDF has on the way to the sensor."""
    joint = str(rng.choice(rec.joints())).split(".")[1]
    rec.columns = {n: v for n, v in rec.columns.items() if not n.startswith(f"joint.{joint}.")}
    return Made(f"no columns of {joint}")


def continuous(rec: Recording, rng: Rng) -> Made:
    """Right, though rare: joints of type `continuous`, without position limits."""
    del rng
    name, text = _urdf(rec)
    text = text.replace('type="revolute"', 'type="continuous"')
    rec.files[name] = re.sub(r'lower="[^"]*" upper="[^"]*" ', "", text)
    return Made("joints are continuous")


def mimic(rec: Recording, rng: Rng) -> Made:
    """Right, though rare: a gripper whose finger mimics a joint, neither of which has a column."""
    del rng
    name, text = _urdf(rec)
    led = rec.joints()[0].split(".")[1]
    finger = (
        '<link name="finger_l"/><link name="finger_r"/>'
        '<joint name="finger_left" type="fixed"><parent link="base"/><child link="finger_l"/></joint>'
        '<joint name="finger_right" type="revolute"><parent link="finger_l"/><child link="finger_r"/><axis xyz="0 1 0"/>'
        f'<limit lower="0" upper="1" effort="1" velocity="1"/><mimic joint="{led}" multiplier="-1"/></joint>'
    )
    rec.files[name] = text.replace("</robot>", finger + "</robot>")
    return Made("a mimic joint without a column")


EFFORT = ("arm6-effort", "panda", "proof-effort")
URDF = ("arm6-wrench", "arm6-effort", "arm6-pose")
MASSLESS = (
    r"\bno (?:mass|inertial|inertia)|without (?:mass|inertial)|<inertial>"
    r"|mass(?:es)?.{0,60}(?:zero|\b0\b|missing|lack)|(?:zero|missing|lacks?).{0,60}(?:mass|inertial)"
)
LINK = r"sensor_?link|no link|\b(?:ft_sensor|ft_link|FT|tool0)\b.{0,80}\b(?:no|not|in)\b"
HEAVY = r"mass(?:es)?.{0,160}(?:gram|\bg\b|tonne|times|power|unit|1000|heav|light|kg)"
LARGE = r"inertia.{0,160}(?:mm|times|power|unit|1000|size|radius|big|large|body|possible)"
NO_BODY = r"triangle|inertia.{0,120}(?:no body|possible|negative|below zero|positive|physical)|no (?:real )?body"

KINDS = (
    Kind("no_masses", ABOUT, "diagnose", EFFORT, no_masses, (MASSLESS,)),
    Kind(
        "one_inertial_missing",
        ABOUT,
        "diagnose",
        EFFORT,
        one_missing,
        (MASSLESS,),
        fits=lambda r: len(_heavy(_urdf(r)[1])) > 2,
    ),
    Kind("masses_scaled", ABOUT, "diagnose", EFFORT, masses_scaled, (HEAVY,)),
    Kind("inertias_scaled", ABOUT, "diagnose", EFFORT, inertias_scaled, (LARGE,)),
    Kind("inertia_no_body", ABOUT, "diagnose", EFFORT, no_body, (NO_BODY,)),
    Kind("no_sensor_link", ABOUT, "diagnose", ("arm6-wrench",), no_sensor_link, (LINK,)),
    Kind(
        "no_sensor_link_static", ABOUT, "calibrate", ("static",), no_sensor_link, (LINK,), needs=frozenset({"joints"})
    ),
    Kind(
        "joint_without_column",
        ABOUT,
        "diagnose",
        URDF,
        joint_without_column,
        (r"column|joint.{0,80}(?:missing|without|no )",),
    ),
    Kind("continuous_joints", ABOUT, "diagnose", URDF, continuous, (), silent=True),
    Kind("mimic_joint", ABOUT, "diagnose", URDF, mimic, (), silent=True),
)
