"""What is said in plain words: of findings, why they are believed, and why look-alikes cannot be told apart.

The words themselves stand with each effect, see `Words`.
"""

from collections.abc import Iterable
from typing import Final

from galen_hw.physics.effects.registry import effect_class
from galen_hw.physics.scenes.base import Scene

ALIKE: Final = "both make the same signal in this recording, to within its noise"
REPEATED: Final = "record a motion over a wider range, at two speeds"


def why(found: str, rival: str) -> str:
    """Why two effects cannot be told apart: by structure where that is known, else what this recording shows."""
    one, other = effect_class(found), effect_class(rival)
    return one.ALIKE.get(rival) or other.ALIKE.get(found) or ALIKE


def structural(found: str, scene: Scene, parameters: Iterable[str] = ()) -> list[str]:
    """Effects that no recording of this kind can tell from the one found, whatever the likelihood says.

    Args:
        found: key; parameters: names of the finding's parameters.
    """
    return effect_class(found).structural(scene, list(parameters))


def settled_by(found: str, rival: str) -> str:
    """What would tell two effects apart where it cannot be simulated."""
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
