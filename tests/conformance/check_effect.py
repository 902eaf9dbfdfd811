"""What every effect must hold to, as plain functions; `tests/test_physics_effects.py` runs them on the whole table."""

import numpy as np

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.scenes.base import Scene


def check_null(effect: Effect, scene: Scene) -> None:
    """At zero parameters it changes nothing at all."""
    assert np.all(effect.change(scene, np.zeros(len(effect.parameters(scene)))) == 0.0)


def check_columns(effect: Effect, scene: Scene) -> None:
    """Columns fit the parameters, the rows and the channels, and are finite."""
    columns = effect.columns(scene)
    assert columns.values.shape == (len(scene), len(columns.channels), len(effect.parameters(scene)))
    assert np.isfinite(columns.values).all()
    assert all(0 <= c < len(scene.channels) for c in columns.channels)


def check_slope(effect: Effect, scene: Scene) -> None:
    """The columns are the slope of what it predicts at zero."""
    k = len(effect.parameters(scene))
    if effect.exact(scene, np.zeros(k)) is None or effect.KEY == "time_delay":
        return
    full = effect.columns(scene).full(len(scene.channels))
    for i in range(k):
        step = np.zeros(k)
        step[i] = 1e-5
        slope = (effect.change(scene, step) - effect.change(scene, -step)) / 2e-5
        np.testing.assert_allclose(slope, full[:, :, i], atol=1e-6 + 1e-4 * np.abs(full[:, :, i]).max())


def check_term(effect: Effect, scene: Scene) -> None:
    """It survives the way to a term and back."""
    theta = np.linspace(0.5, 1.5, len(effect.parameters(scene)))
    term = effect.to_term(scene, theta)
    again = type(effect).from_term(term["parameters"])
    assert again == effect
    np.testing.assert_array_equal(again.theta_of(scene, term["parameters"]), theta)


def check_units(effect: Effect, scene: Scene) -> None:
    """Every parameter has a name of its own and a unit; searched ones lie within their bounds."""
    names = [p.name for p in effect.parameters(scene)]
    assert len(set(names)) == len(names)
    assert all(p.unit for p in effect.parameters(scene))
    for name, value in effect.searched().items():
        assert effect.SEARCHED[name].low <= value <= effect.SEARCHED[name].high


def check_docstring(effect: type[Effect]) -> None:
    """The docstring says the equation, when it is visible and what it is confused with."""
    text = (effect.__doc__ or "").lower()
    assert "visible" in text
    assert "confus" in text or "nested" in text or "not it" in text


CHECKS = (check_null, check_columns, check_slope, check_term, check_units)
