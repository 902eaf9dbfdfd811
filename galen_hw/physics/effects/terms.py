"""Effects as terms of a tool's file: which can be served live, their dates, and what they add to a simulation."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.physics.effects.interactions import compound
from galen_hw.physics.effects.registry import effect_of
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.physics.scenes.base import Scene

Term = Mapping[str, Any]

NOT_LIVE: Final[dict[str, str]] = {
    "contact": "an outside force is what the compensation is there to show",
    "glitches": "single samples cannot be foreseen",
    "unknown": "it has no model",
    "temperature": "no thermometer is read live",
    "saturation": "a clipped reading cannot be restored",
    "vibration": "its phase does not last from one recording to the next",
    "inertial": "set dynamic = true under [services.compensation] instead",
}
"""What joints and time alone cannot predict, and why."""

DATED: Final[dict[str, str]] = {"drift": "start", "step": "moment", "payload": "since"}
"""Effects that last from a moment on, and the parameter that dates them: in a file in s since the epoch."""


def why_not_live(term: Term, group: str = "wrench") -> str:
    """Say why a term cannot be served in a group's live prediction; empty if it can."""
    own = term.get("parameters", {}).get("group", group)
    if own != group:
        return f"it belongs to the group {own!r}"
    if term.get("parameters", {}).get("by"):
        return "the covariate that it goes with is not read live"
    return NOT_LIVE.get(term["effect"], "")


def is_dated(term: Term) -> bool:
    """Return whether a term says from when on it holds: of a payload only what changed."""
    return term.get("parameters", {}).get(DATED.get(term["effect"], "")) is not None


def dated(term: Term, shift: float) -> dict[str, Any]:
    """Return a term with its moment, if any, moved by `shift` s: from a recording's clock to the epoch or back."""
    parameters = dict(term["parameters"])
    if is_dated(term):
        name = DATED[term["effect"]]
        parameters[name] = float(parameters[name]) + shift
    return {**term, "parameters": parameters}


def known_change(scene: "Scene", terms: Sequence[Term]) -> Array:
    """Return what (N, C) the terms of a file add to a scene's simulation together, as the live services add them.

    Terms of other groups, terms that are not served live, and dated ones in a recording that does not say when it was
    made are left out.
    """
    out = np.zeros((len(scene), len(scene.channels)))
    effects = [(effect_of(term), term["parameters"]) for term in usable(scene, terms)]
    return sum(compound(scene, [(e, e.theta_of(scene, values)) for e, values in effects]), out)


def usable(scene: "Scene", terms: Sequence[Term]) -> list[dict[str, Any]]:
    """Return the terms that a scene's simulation can hold, on its own clock."""
    group, epoch = scene.observations.predict, scene.belief.epoch
    found = [t for t in terms if not why_not_live(t, group) and (epoch is not None or not is_dated(t))]
    return [dated(t, -epoch if epoch is not None else 0.0) for t in found]
