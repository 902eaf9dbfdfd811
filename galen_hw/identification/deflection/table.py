"""The table of deflection models: one line a model; modules are loaded when they are needed."""

import importlib
from typing import Any, Final

from galen_hw.errors import UsageError
from galen_hw.identification.deflection.model import DeflectionModel

MODELS: Final[dict[str, str]] = {
    "independent linear": "galen_hw.identification.deflection.linear:IndependentLinear",
    "coupled linear": "galen_hw.identification.deflection.linear:CoupledLinear",
    "LSTM (report)": "galen_hw.identification.deflection.lstm:Lstm",
    "gradient boosting": "galen_hw.identification.deflection.boosting:Boosting",
    "elastic arm": "galen_hw.identification.deflection.elastic:ElasticArm",
}


def model_class(name: str) -> type[DeflectionModel]:
    """The class of a model's name.

    Raises:
        UsageError: no such model.
    """
    if name not in MODELS:
        raise UsageError(f"no deflection model {name!r}", where="model", todo=f"one of: {', '.join(MODELS)}")
    module, _, kind = MODELS[name].partition(":")
    return getattr(importlib.import_module(module), kind)  # type: ignore[no-any-return]


def model_of(name: str, values: dict[str, Any]) -> DeflectionModel:
    """The fitted model of a file.

    Raises:
        UsageError: no such model, or values that do not fit it.
    """
    try:
        return model_class(name).from_json(values)
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(
            f"the numbers of {name!r} are damaged ({error})", where="values", todo="fit it again"
        ) from error
