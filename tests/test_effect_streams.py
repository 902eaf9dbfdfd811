"""Every effect of the table, row by row with its memory carried along, against the whole batch; in every group."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import WRENCH, Bench
from physics_scenes import scene

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.cable import CableDrag
from galen_hw.physics.effects.drift import Drift
from galen_hw.physics.effects.events import Contact, Step, Vibration
from galen_hw.physics.effects.friction import TorqueRipple
from galen_hw.physics.effects.registry import EFFECTS, effect_class, scene_of
from galen_hw.physics.effects.sensor import CrossTalk
from galen_hw.physics.scenes.base import Scene

GROUPS = ("wrench", "pose", "targets", "effort", "position")
ROWS = 120


def made(group: str) -> Scene:
    """A scene that already knows its simulation, so that a single row has the same one."""
    first = scene(group, np.random.default_rng(5), rows=ROWS)
    given = dict(zip(first.channels, first.simulated.T, strict=True))
    return scene_of(replace(first.observations, simulation=given)) if group == "position" else first


def hypotheses(whole: Scene) -> list[Effect]:
    """One of each kind and form; of what has a joint or a channel, the last one."""
    first, last = whole.channels[0], whole.channels[-1]
    found = [e for key in EFFECTS for e in effect_class(key).propose(whole)]
    found += [Step((first,), 5.0), Vibration((first, last), 3.0), Contact((first,), ((2.0, 4.0), (7.0, 8.0)))]
    found.append(Drift("", "wander", None, 0.0, 10.0, (first, last)))
    found += [Step((), 5.0, one.name) for one in whole.slipping()]
    if whole.observations.predict in ("wrench", "effort"):
        found += [CableDrag("tendon"), CableDrag("tendon_dry"), CableDrag("tendon_eye")]
    if whole.observations.predict == "effort":
        found.append(TorqueRipple("elbow", 9.0))
    found += [richer for e in found for richer in e.richer(whole)]
    kinds = {
        (e.KEY, getattr(e, "form", ""), getattr(e, "part", ""), bool(getattr(e, "channels", "")), *e.searched()): e
        for e in found
    }
    return list(kinds.values())


def row_by_row(whole: Scene, effect: Effect, theta: np.ndarray) -> np.ndarray:
    """The effect on scenes of one row that hand their memory on."""
    memory: dict = {}
    return np.array([effect.change(whole.row(k, memory), theta)[0] for k in range(len(whole))])


@pytest.mark.parametrize("group", GROUPS)
def test_row_by_row_gives_what_the_batch_gives(group):
    """To rounding, for every hypothesis of every key that shows in the group, memory carried along."""
    whole = made(group)
    seen = set()
    for effect in hypotheses(whole):
        theta = np.full(len(effect.parameters(whole)), 0.013)
        batch = effect.change(whole, theta)
        rows = row_by_row(whole, effect, theta)
        size = max(float(np.abs(batch).max()), 1e-12)
        np.testing.assert_allclose(rows, batch, atol=1e-9 * size, err_msg=str(effect))
        seen.add(effect.KEY)
    assert len(seen) > 8, seen


def test_what_is_less_than_the_scatter_of_its_readings_leaks_into_nothing() -> None:
    """An ATI Gamma on a KUKA: a force of 8e-6 N in the simulation was told to leak with -282 N m/N."""
    case = Bench(4, rows=2000)
    seen = case.observations()
    still = scene_of(replace(seen, columns=dict(seen.columns) | {"wrench.force.y": case.noise[:, 1]}))
    still.simulated[:, 1] = 1e-3 * case.noise[::-1, 1]
    assert {one.source for one in CrossTalk.propose(still)} == set(WRENCH) - {"wrench.force.y"}
    assert {one.source for one in CrossTalk.propose(scene_of(seen))} == set(WRENCH)
