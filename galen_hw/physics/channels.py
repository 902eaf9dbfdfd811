"""What the names of channels say."""


def joint_of(channel: str) -> str:
    """NAME of joint.NAME.kind."""
    return channel.split(".", 1)[1].rsplit(".", 1)[0] if channel.startswith("joint.") else ""


def joint_unit(joint: str) -> str:
    """Metres for the Galen's carriages, radians otherwise."""
    return "m" if joint.startswith("carriage") else "rad"
