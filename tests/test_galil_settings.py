"""Settings of the Galil driver: each mistake is named."""

import pytest
from pydantic import ValidationError

from galen_hw.drivers.galil_dmc import GalilDmc


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lower": 1.0, "upper": 0.0}, "is not below upper"),
        ({"velocity": 5.0}, "above its own maximum"),
        ({"counts_per_unit": 1e10}, "32-bit"),
        ({"axis": "a"}, "axis"),
        ({"speed": 1.0}, "speed"),
    ],
)
def test_impossible_axes_are_refused(change, words):
    """Each mistake of the settings is named."""
    axis = GalilDmc.Settings().axes[3].model_dump() | change
    with pytest.raises(ValidationError, match=words):
        GalilDmc.Settings(axes=[axis])


def test_an_axis_named_twice_is_refused():
    """Two joints on one axis are a mistake."""
    axes = [axis.model_dump() for axis in GalilDmc.Settings().axes]
    with pytest.raises(ValidationError, match="axis named twice"):
        GalilDmc.Settings(axes=[axes[0], axes[1] | {"axis": "A"}])
