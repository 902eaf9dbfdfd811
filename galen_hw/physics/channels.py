"""What the names of channels say."""


def joint_of(channel: str) -> str:
    """Return NAME of joint.NAME.kind; empty where a channel is not of a joint."""
    return channel.split(".", 1)[1].rsplit(".", 1)[0] if channel.startswith("joint.") else ""
