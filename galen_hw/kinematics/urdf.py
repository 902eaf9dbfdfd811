"""A URDF as it is written: links with their own bodies, joints with what they follow and how they rub.

Pinocchio gives the motion; what it does not keep (bodies it did not read, mimic, friction) is read here, and what
it reads in another way than its users expect is written for it so that every moving joint has one plain coordinate.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.lazy import cached_property
from galen_hw.spatial import Array, rotation_about

TURNING: Final = ("revolute", "continuous")
MOVING: Final = (*TURNING, "prismatic")
FREE: Final = ("floating", "planar")
"""Joints of several coordinates: nothing that is recorded drives them."""


@dataclass(frozen=True, slots=True)
class Link:
    """A link's own body.

    Args:
        mass: kg, as written, of whatever sign.
        com: (3,) in the link's axes, m.
        inertia: (3, 3) about the centre of mass in the link's axes, kg m^2.
        unread: why its <inertial> cannot be read; empty where it can, or where there is none.
    """

    name: str
    mass: float
    com: Array
    inertia: Array
    unread: str = ""


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: q = multiplier q_source + offset."""

    source: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint; damping in N m s/rad or N s/m, friction in N m or N.

    Args:
        place: (3,) of the child in the parent at zero, m; travel: lower and upper limit, rad or m.
    """

    name: str
    kind: str
    parent: str
    child: str
    mimic: Mimic | None = None
    damping: float = 0.0
    friction: float = 0.0
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    travel: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Urdf:
    """What a file says, and its text as pinocchio is to read it."""

    name: str
    where: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    text: str

    @property
    def root(self) -> str:
        """The link that no joint carries."""
        carried = {joint.child for joint in self.joints.values()}
        return next(name for name in self.links if name not in carried)

    @property
    def leaves(self) -> tuple[str, ...]:
        """Links that carry no other."""
        carrying = {joint.parent for joint in self.joints.values()}
        return tuple(name for name in self.links if name not in carrying)

    def carriers(self, link: str) -> tuple[str, ...]:
        """Joints from the root to a link, the root's first, fixed ones too."""
        out: list[str] = []
        while link in self._by_child:
            out.append(self._by_child[link].name)
            link = self._by_child[link].parent
        return tuple(out[::-1])

    @cached_property
    def _by_child(self) -> Mapping[str, Joint]:
        return {joint.child: joint for joint in self.joints.values()}

    def longest(self) -> str:
        """The link to which most moving joints lead, followed as far as one way is longer than all others.

        It does not depend on the order of names: an arm goes before a head, and of two equal fingers neither is taken but
        the hand.
        """
        below: dict[str, list[Joint]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            below[joint.parent].append(joint)
        depth = dict.fromkeys(self.links, 0)
        for name in self.links:
            moving = sum(self.joints[j].kind in MOVING for j in self.carriers(name))
            for upper in (name, *(self.joints[j].parent for j in self.carriers(name))):
                depth[upper] = max(depth[upper], moving)
        link = self.root
        while below[link]:
            most = max(depth[joint.child] for joint in below[link])
            ways = [joint.child for joint in below[link] if depth[joint.child] == most]
            if len(ways) > 1:
                break
            link = ways[0]
        return link


def read_urdf(urdf: Path | str) -> Urdf:
    """A URDF from its file (a Path), or from its text (a str).

    Raises:
        UsageError: it cannot be read, or is no tree of links; the line says where.
    """
    if isinstance(urdf, str):
        where, content = "URDF", urdf.strip().encode()
        # A text has no encoding of its own any more, whatever its first line says.
        if content.startswith(b"<?xml"):
            content = content.partition(b"?>")[2]
    else:
        where = str(urdf)
        if not urdf.is_file():
            raise UsageError("no such file", where=where, todo="check the path")
        content = urdf.read_bytes()
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise UsageError("not a readable URDF (it declares a document type)", where=where, todo="leave <!DOCTYPE out")
    try:
        root = ET.fromstring(content)  # noqa: S314 - entities are refused above, and expat bounds what they grow to
    except (ET.ParseError, ValueError, LookupError, RecursionError) as error:
        raise UsageError(f"not a readable URDF ({error})", where=where, todo="check the file") from error
    return _described(root, where)


def _described(root: ET.Element, where: str) -> Urdf:
    if root.tag != "robot":
        raise UsageError(f"not a readable URDF (its root is <{root.tag}>)", where=where, todo="name a URDF")
    if any("xacro" in one.tag for one in root.iter() if isinstance(one.tag, str)):
        # It is not expanded here: a xacro file runs Python expressions and reads other files.
        todo = (
            "for a recording name it with --robot FILE.xacro; else make a URDF of it: xacrodoc FILE.xacro -o robot.urdf"
        )
        raise UsageError("a xacro file, which is no URDF yet", where=where, todo=todo)
    name = root.get("name") or "robot"
    where = f"{where}: {name}" if where == "URDF" else where
    links = {one.get("name", ""): _link(one) for one in root.findall("link")}
    joints = {one.get("name", ""): _joint(one, where) for one in root.findall("joint")}
    # One that follows a joint that is not there has to be read itself.
    lost = [name for name, joint in joints.items() if joint.mimic and joint.mimic.source not in joints]
    joints |= {name: replace(joints[name], mimic=None) for name in lost}
    _whole(root, links, joints, where)
    root.set("name", name)
    for one in root.findall("joint"):
        _plain(one, joints[one.get("name", "")])
    for one in root.findall("link"):
        # Pinocchio's reader leaves an <inertial> that it cannot read out, as here, but complains past everybody.
        inertial = one.find("inertial")
        if inertial is not None and links[one.get("name", "")].unread:
            one.remove(inertial)
    return Urdf(name, where, links, joints, ET.tostring(root, encoding="unicode"))


def _whole(root: ET.Element, links: Mapping[str, Link], joints: Mapping[str, Joint], where: str) -> None:
    """One tree: no name twice, no link that is not there, one root from which all others are reached."""
    for kind, found in (("link", links), ("joint", joints)):
        names = [one.get("name", "") for one in root.findall(kind)]
        twice = [n for n in names if names.count(n) > 1]
        if twice or "" in found:
            what = f"two {kind}s are named {twice[0]!r}" if twice else f"a {kind} has no name"
            raise UsageError(what, where=where, todo="give each a name of its own")
    for joint in joints.values():
        lost = [link for link in (joint.parent, joint.child) if link not in links]
        if lost:
            raise UsageError(f"no link {lost[0]!r}", where=f"{where}: joint {joint.name}", todo="name its links")
    children = [joint.child for joint in joints.values()]
    roots = [name for name in links if name not in children]
    if not links or len(roots) != 1 or len(set(children)) != len(children):
        what = f"not one tree of links: {len(links)} links, roots {', '.join(roots) or 'none'}"
        raise UsageError(what, where=where, todo="connect every link but one to a parent by one joint")
    reached, ahead = 0, [roots[0]]
    while ahead:
        link = ahead.pop()
        reached += 1
        ahead += [joint.child for joint in joints.values() if joint.parent == link]
    if reached != len(links):
        raise UsageError("some joints form a loop", where=where, todo="cut the loop: a URDF is a tree")


def _plain(element: ET.Element, joint: Joint) -> None:
    """One coordinate a moving joint: a continuous one as an angle without an end; none where nothing drives it."""
    if joint.kind == "continuous":
        element.set("type", "revolute")
        limit = element.find("limit")
        limit = ET.SubElement(element, "limit", {"effort": "0", "velocity": "0"}) if limit is None else limit
        limit.set("lower", "-1e9")
        limit.set("upper", "1e9")
    if joint.kind in FREE:
        element.set("type", "fixed")
    for limit in element.findall("limit"):
        # Nothing here asks for them, and pinocchio's reader does not do without.
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key, "0"))
    for mimic in element.findall("mimic"):
        element.remove(mimic)


def _joint(element: ET.Element, where: str) -> Joint:
    name, kind = element.get("name", ""), element.get("type", "")
    at = f"{where}: joint {name}"
    if kind not in (*MOVING, *FREE, "fixed"):
        raise UsageError(f"unknown type {kind!r}", where=at, todo="fixed, revolute, continuous or prismatic")
    if kind in ("revolute", "prismatic") and element.find("limit") is None:
        raise UsageError("it has no <limit>", where=at, todo="set limits, or make it continuous")
    axis, origin = element.find("axis"), element.find("origin")
    if kind in MOVING and axis is not None and not np.any(_numbers(axis, "xyz", (1.0, 0.0, 0.0), at)):
        raise UsageError("its axis has no length", where=at, todo="set the axis")
    ends = [found.get("link", "") if (found := element.find(tag)) is not None else "" for tag in ("parent", "child")]
    mimic, dynamics = element.find("mimic"), element.find("dynamics")
    follows = None
    if mimic is not None and kind in MOVING:
        follows = Mimic(
            mimic.get("joint", ""), _number(mimic, "multiplier", 1.0, at), _number(mimic, "offset", 0.0, at)
        )
    damping, friction = (
        0.0 if dynamics is None else _number(dynamics, key, 0.0, at) for key in ("damping", "friction")
    )
    x, y, z = np.zeros(3) if origin is None else _numbers(origin, "xyz", (0.0, 0.0, 0.0), at)
    limit = element.find("limit") if kind in ("revolute", "prismatic") else None
    low, high = (0.0 if limit is None else _number(limit, key, 0.0, at) for key in ("lower", "upper"))
    return Joint(name, kind, ends[0], ends[1], follows, damping, friction, (x, y, z), (low, high))


def _link(element: ET.Element) -> Link:
    name, none = element.get("name", ""), (0.0, np.zeros(3), np.zeros((3, 3)))
    inertial = element.find("inertial")
    if inertial is None:
        return Link(name, *none)
    try:
        mass, inertia = _inside(inertial, "mass"), _inside(inertial, "inertia")
        origin = inertial.find("origin")
        xyz, rpy = (
            np.zeros(3) if origin is None else _numbers(origin, key, (0.0, 0.0, 0.0), "") for key in ("xyz", "rpy")
        )
        xx, xy, xz, yy, yz, zz = (_number(inertia, f"i{k}", None, "") for k in ("xx", "xy", "xz", "yy", "yz", "zz"))
        R = _rotation(rpy)
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return Link(name, _number(mass, "value", None, ""), xyz, R @ own @ R.T)
    except UsageError as error:
        return Link(name, *none, unread=error.what)


def _inside(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    if found is None:
        raise UsageError(f"it has no <{tag}>")
    return found


def _rotation(rpy: Array) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = (rotation_about(axis, angle) for axis, angle in enumerate(rpy))
    return np.asarray(yaw @ pitch @ roll)


def _number(element: ET.Element, key: str, otherwise: float | None, where: str) -> float:
    text = element.get(key)
    if text is None and otherwise is not None:
        return otherwise
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        what = f"<{element.tag}> has no {key}" if text is None else f"<{element.tag}> {key} is {text[:40]!r}"
        raise UsageError(what, where=where, todo="give a number")
    return value


def _numbers(element: ET.Element, key: str, otherwise: tuple[float, float, float], where: str) -> Array:
    words = element.get(key, "").split()
    try:
        values = np.array([float(word) for word in words]) if words else np.array(otherwise)
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        what = f"<{element.tag}> {key} is {element.get(key, '')[:40]!r}"
        raise UsageError(what, where=where, todo="give three numbers")
    return values
