"""A new effect is one file and one line of the table: the engine finds it without knowing it."""

import sys
from pathlib import Path

import numpy as np
import pytest

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.physics.effects import registry
from tests import diagnosis_parts as parts

TOY = '''
"""A magnet beside the arm."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.parameters import Parameter
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Magnet(Effect):
    """A magnet beside the arm pulls the tool, strongly near one position of a joint."""

    KEY = "magnet"
    joint: str

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        yield from (cls(joint) for joint in scene.moved)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return (Parameter("pull", "N"),)

    def columns(self, scene: Scene) -> Columns:
        q = scene.q[:, scene.joint_index(self.joint)]
        return Columns((0,), pull(q)[:, None, None])


def pull(q: Array) -> Array:
    """One at half the way of the joint, and little elsewhere."""
    middle, width = 0.5 * (q.max() + q.min()), 0.1 * (q.max() - q.min())
    return np.asarray(1.0 / (1.0 + ((q - middle) / width) ** 2))
'''


def test_an_effect_that_the_engine_does_not_know_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "toy_magnet.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(registry.EFFECTS, "magnet", "toy_magnet:Magnet")
    scene = parts.nominal(rows=800)
    wrench = scene.simulated.copy()
    import toy_magnet  # type: ignore[import-not-found]

    wrench[:, 0] += 0.08 * toy_magnet.pull(scene.q[:, scene.joint_index("tilt")])
    monkeypatch.setitem(sys.modules, "toy_magnet", toy_magnet)
    found = diagnose(parts.recorded(scene, wrench)).diagnosis
    assert [(one.effect, one.joints) for one in found.findings] == [("magnet", ["tilt"])]
    assert found.findings[0].parameters["pull"].value == pytest.approx(0.08, rel=0.1)
    assert found.verdict == "explained"
    assert np.isclose(found.terms[0]["parameters"]["pull"], 0.08, rtol=0.1)
    assert "A magnet beside the arm pulls the tool" in found.findings[0].says
