"""What is wrong with a robot's model: a URDF that no machine can be, or that says less than is asked of it.

The bounds are physics, not experience: no body is denser than osmium, no arm a solid block of steel, none lighter than
hydrogen; of two moments of inertia the sum is at least the third (Wensing, Kim, Slotine 2018); a link's mass lies within the
arm's reach.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from galen_hw.kinematics import UrdfRobot
from galen_hw.kinematics.joint_map import sources
from galen_hw.kinematics.urdf import Link

OSMIUM: Final = 22_590.0
STEEL: Final = 7_850.0
HYDROGEN: Final = 0.09
"""kg/m^3."""
ROUNDED: Final = 0.01
"""Of a moment of inertia: what its digits in a file may hide."""
SLIGHT: Final = 1e-5
"""Of the arm's mass at its reach: an inertia below that has no say in any effort."""
SHOWN: Final = 3
"""Names that are shown of many."""


@dataclass(frozen=True, slots=True)
class ModelProblem:
    """One finding: what, where, what to do.

    Args:
        severity: "refuse" where nothing may be fitted on such a model, "note" where it is to be said.
    """

    what: str
    where: str
    todo: str
    severity: Literal["refuse", "note"] = "note"

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.todo}"


def model_problems(
    robot: UrdfRobot, *, sensor_named: bool, frames: bool = True, masses: bool = True
) -> list[ModelProblem]:
    """Return all findings of a model by itself.

    Args:
        robot: with the joints that are read.
        sensor_named: somebody has said which link is the sensor's.
        frames: the sensor's axes are part of what is simulated; else it is only where a load hangs.
        masses: what the links weigh is part of what is simulated.
    """
    out = sensor_problems(robot, named=sensor_named, frames=frames)
    return out + (mass_problems(robot) + body_problems(robot) + friction_notes(robot) if masses else [])


def sensor_problems(robot: UrdfRobot, *, named: bool, frames: bool = True) -> list[ModelProblem]:
    """Return the problem of a sensor link that nobody has named: refused where another could be meant."""
    if named or len(robot.urdf.links) == 1:
        return []
    leaves, where = robot.urdf.leaves, f"{robot.urdf.where}: sensor_link"
    if len(leaves) > 1 and frames:
        what = f"no sensor_link is named, and the model ends in {len(leaves)} links"
        return [ModelProblem(what, where, f"name the sensor's link, e.g. one of: {_some(leaves)}", "refuse")]
    what = f"no sensor_link is named: the sensor is taken to be link {robot.sensor_link}"
    return [ModelProblem(what, where, "name the sensor's link if it is another")]


def missing_joints(
    names: Sequence[str], having: Collection[str], where: str, what: str = "motor"
) -> list[ModelProblem]:
    """Return a problem of joints that move the sensor and that nobody reads.

    Args:
        names: of the joints; having: of those that are read; what: by what, e.g. "motor" or "column".
    """
    missing = [name for name in names if name not in having]
    if not missing:
        return []
    line = f"no {what} has {'the joint' if len(missing) == 1 else 'the joints'} {_some(missing)}"
    todo = f"name them alike: there {'is one' if len(having) == 1 else 'are some'} for {', '.join(having) or 'none'}"
    return [ModelProblem(line, where, todo, "refuse")]


def base_problems(robot: UrdfRobot, having: Collection[str]) -> list[ModelProblem]:
    """Return a problem of joints that move the base and that nobody reads: it is taken to stand at their zero."""
    missing = [name for name in robot.moving_base if name not in having]
    if not missing:
        return []
    line = f"base_link {robot.base_link} is moved by {_some(missing)}, taken to stand at zero"
    return [ModelProblem(line, f"{robot.urdf.where}: base_link", "record them, or name a base that stands still")]


def mass_problems(robot: UrdfRobot) -> list[ModelProblem]:
    """Return the problems of masses: none, one below zero, or one that is off by powers of ten."""
    where, moved = robot.urdf.where, _moved(robot)
    out = [_refused(f"a mass of {x.mass:g} kg", where, x, "give its mass in kg") for x in moved if x.mass < 0.0]
    total, reach = sum(link.mass for link in moved), _reach(robot)
    if moved and total == 0.0:
        what = f"no mass: none of the {len(moved)} links that move weighs anything"
        out.append(ModelProblem(what, where, "give each <inertial>: mass, origin and inertia", "refuse"))
    if total > STEEL * reach**3 > 0.0:
        what = f"its links weigh {total:.4g} kg at a reach of {reach:.3g} m, more than a block of steel of that size"
        out.append(ModelProblem(what, where, "give masses in kg (are they in g?) and lengths in m", "refuse"))
    reach = _reach(robot, travel=False)
    if 0.0 < total < HYDROGEN * reach**3:
        what = f"its links weigh {total:.4g} kg at a reach of {reach:.3g} m, less than hydrogen in a cube of that size"
        out.append(ModelProblem(what, where, "give masses in kg (are they in t?) and lengths in m (are they in mm?)"))
    bodiless = [name for name in robot.bodiless if not robot.urdf.links[name].unread] if total > 0.0 else []
    if bodiless:
        what = f"no <inertial> of {_some(bodiless)}, nor of what is fixed to it: it weighs nothing"
        out.append(ModelProblem(what, where, "give its mass, origin and inertia if it has any"))
    return out + [problem for link in moved if (problem := _unread(robot, link))]


def body_problems(robot: UrdfRobot) -> list[ModelProblem]:
    """Return the problems of inertias that are no body's, or are off by powers of ten, as far as they have a say."""
    where, reach, moved = robot.urdf.where, _reach(robot), _moved(robot)
    slight = SLIGHT * sum(abs(link.mass) for link in moved) * reach**2
    out: list[ModelProblem] = []
    odd: list[str] = []
    for link in moved:
        least, middle, most = np.linalg.eigvalsh(link.inertia)
        if max(abs(least), abs(most)) <= slight or link.mass < 0.0:
            continue
        apart = float(np.sqrt(max(most, 0.0) / link.mass)) if link.mass else np.inf
        if least < -ROUNDED * abs(most):
            out.append(_refused(f"a moment of inertia below zero ({least:.3g} kg m^2)", where, link, _AGAIN))
        elif apart > reach > 0.0:
            what = f"an inertia of {most:.3g} kg m^2 at {link.mass:.3g} kg, as if it were {apart:.3g} m from its centre"
            todo = f"give masses in kg and inertias in kg m^2{_in_unit(most, link.mass, reach)}"
            out.append(_refused(f"{what}, beyond the arm's reach of {reach:.3g} m", where, link, todo))
        elif least + middle < (1.0 - ROUNDED) * most:
            odd.append(f"{link.name} ({least:.3g}, {middle:.3g}, {most:.3g})")
    if odd:
        what = f"moments of inertia that no body has, the largest above the sum of the others: {_some(odd)} kg m^2"
        out.append(ModelProblem(what, where, _AGAIN))
    small = [x.name for x in moved if x.mass > 0.0 and np.linalg.eigvalsh(x.inertia)[2] < _densest(x.mass)]
    if small and sum(_densest(x.mass) for x in moved if x.name in small) > slight:
        what = f"the inertia of {_some(small)} is less than that of any material of that mass"
        out.append(ModelProblem(what, where, "give inertias in kg m^2 (0 stands for a point)"))
    return out


INERTIAS: Final = {"g m^2": 1e3, "kg cm^2": 1e4, "kg mm^2": 1e6, "g mm^2": 1e9}


def _in_unit(inertia: float, mass: float, reach: float) -> str:
    """Return the units in which an inertia would fit a body of this mass inside the reach (m), as a question; else empty."""
    names = [u for u, f in INERTIAS.items() if _densest(mass) <= inertia / f <= mass * reach**2]
    return f" (is the inertia's unit {' or '.join(names)}?)" if names else ""


_AGAIN: Final = "export it again, in kg m^2 about the centre of mass"


def friction_notes(robot: UrdfRobot) -> list[ModelProblem]:
    """Return notes on <dynamics> of joints: read, but no part of the simulation."""
    rubbing = [robot.urdf.joints[name] for name in robot.joint_names]
    said = [
        f"{joint.name} ({joint.friction:g} {'N' if robot.slides(joint.name) else 'N m'}, {joint.damping:g} per rate)"
        for joint in rubbing
        if joint.friction or joint.damping
    ]
    if not said:
        return []
    what = f"friction and damping that the file declares are no part of the simulation: {_some(said)}"
    return [ModelProblem(what, f"{robot.urdf.where}: dynamics", "expect them among what is found")]


def _unread(robot: UrdfRobot, link: Link) -> ModelProblem | None:
    if not link.unread:
        return None
    return _refused(f"its <inertial> is not read: {link.unread}", robot.urdf.where, link, "give mass and inertia")


def _refused(what: str, where: str, link: Link, todo: str) -> ModelProblem:
    return ModelProblem(what, f"{where}: link {link.name}", todo, "refuse")


def _moved(robot: UrdfRobot) -> list[Link]:
    """Return the links that the joints move that are read."""
    read, urdf = set(robot.joint_names), robot.urdf
    return [link for name, link in urdf.links.items() if read.intersection(sources(urdf, urdf.carriers(name)))]


def _reach(robot: UrdfRobot, *, travel: bool = True) -> float:
    """Return the farthest way, m, from the root to a link or its centre of mass, links stretched, rails run out if `travel`."""
    urdf = robot.urdf
    lengths = {name: float(np.linalg.norm(joint.place)) for name, joint in urdf.joints.items()}
    runs = {n: max(map(abs, j.travel)) for n, j in urdf.joints.items() if travel and j.kind == "prismatic"}
    ways = [
        sum(lengths[j] + runs.get(j, 0.0) for j in urdf.carriers(name)) + float(np.linalg.norm(link.com))
        for name, link in urdf.links.items()
    ]
    return max(ways)


def _densest(mass: float) -> float:
    """Return the moment of inertia, kg m^2, of a ball of osmium: no body of that mass has a smaller largest moment of inertia."""
    radius = (3.0 * mass / (4.0 * np.pi * OSMIUM)) ** (1.0 / 3.0)
    return float(0.4 * mass * radius**2)


def _some(names: Collection[str]) -> str:
    shown = ", ".join(list(names)[:SHOWN])
    return f"{shown} and {len(names) - SHOWN} more" if len(names) > SHOWN else shown
