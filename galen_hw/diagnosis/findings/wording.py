"""Words for findings: what they are, why they are believed, and why look-alikes cannot be told apart.

The words themselves are in each effect's class, see `Words`.
"""

from collections.abc import Iterable
from typing import Final

from galen_hw.physics.effects.registry import effect_class
from galen_hw.physics.scenes.base import Scene

ALIKE: Final = "both make the same signal in this recording, to within its noise"
REPEATED: Final = "record a motion over a wider range, at two speeds"


def why(found: str, rival: str) -> str:
    """Return why two effects cannot be told apart: by structure where that is known, else by this recording."""
    one, other = effect_class(found), effect_class(rival)
    return one.ALIKE.get(rival) or other.ALIKE.get(found) or ALIKE


def structural(found: str, scene: Scene, parameters: Iterable[str] = ()) -> list[str]:
    """Return effects that no recording of this kind can tell from the one found, whatever the likelihood.

    Args:
        found: key; parameters: names of the finding's parameters.
    """
    return effect_class(found).structural(scene, list(parameters))


def settled_by(found: str, rival: str) -> str:
    """Return what would tell two effects apart where that cannot be simulated."""
    one, other = effect_class(found), effect_class(rival)
    apart = one.TOLD_APART.get(rival) or other.TOLD_APART.get(found)
    return apart or other.CONFIRMED_BY or one.CONFIRMED_BY or REPEATED


def saying(key: str) -> str:
    """Return what a kind of effect is, in words; of one without words, the first line of its class."""
    kind = effect_class(key)
    return kind.SAYS or (kind.__doc__ or key.replace("_", " ")).splitlines()[0].rstrip(".")


def believing(key: str) -> str:
    """Return by what a kind of effect is known."""
    return effect_class(key).KNOWN_BY
