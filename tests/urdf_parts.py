"""URDFs written in a test: links and joints, in whatever order of names."""

from collections.abc import Iterable

LIMITS = {
    "revolute": '<limit lower="-3" upper="3" velocity="2" effort="100"/>',
    "prismatic": '<limit lower="-0.05" upper="0.05" velocity="2" effort="100"/>',
}


def link(
    name: str, mass: float | str | None = None, *, com: str = "0 0 0.1", inertia: Iterable[float] = (0.01,) * 3
) -> str:
    """A link, with a body where it has a mass."""
    if mass is None:
        return f'<link name="{name}"/>'
    xx, yy, zz = inertia
    moments = f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>{moments}</inertial></link>'


def joint(
    name: str,
    parent: str,
    child: str,
    axis: str = "0 1 0",
    *,
    kind: str = "revolute",
    at: str = "0 0 0.3",
    more: str = "",
) -> str:
    """A joint."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/><axis xyz="{axis}"/>{LIMITS.get(kind, "")}{more}</joint>'
    )


def robot(*parts: str) -> str:
    """The file's text."""
    return f'<robot name="arm">{"".join(parts)}</robot>'


def arm_with_gripper(gripper: str = "gripper", head: str = "head", *, beside: bool = True) -> str:
    """Two joints, a sensor, a gripper of two fingers beyond it and a head beside; names of both as given."""
    parts = [
        link("base", 5.0),
        link("upper", 2.0),
        joint("shoulder", "base", "upper"),
        link("lower", 1.0),
        joint("elbow", "upper", "lower"),
        link("sensor"),
        joint("sensor_mount", "lower", "sensor", kind="fixed"),
    ]
    if beside:
        parts += [
            link(f"{gripper}_palm", 0.3),
            joint(f"{gripper}_mount", "sensor", f"{gripper}_palm", kind="fixed", at="0 0 0"),
        ]
        for side, place in (("l", "0 0.02 0.1"), ("r", "0 -0.02 0.1")):
            finger, follows = f"{gripper}_finger_{side}", ""
            if side == "r":
                follows = f'<mimic joint="{gripper}_l" multiplier="-1"/>'
            parts += [
                link(finger, 0.05, com="0 0 0.02", inertia=(1e-5,) * 3),
                joint(f"{gripper}_{side}", f"{gripper}_palm", finger, kind="prismatic", at=place, more=follows),
            ]
        parts += [link(head, 0.8), joint(f"{head}_pan", "base", head, "0 0 1", at="0 0.2 0.4")]
    return robot(*parts)
