"""All deflection models on the same sets: fitted, judged on sets that none of them saw, one of them recommended."""

import importlib.util
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.identification.deflection.blocks import noise_of
from galen_hw.identification.deflection.compare import Score, judge, wall_shares
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.model import DeflectionModel
from galen_hw.identification.deflection.table import MODELS, model_class
from galen_hw.services.deflection.store import DeflectionFile
from galen_hw.version import VERSION

ENOUGH: Final = 1.2
"""Times the tracker's noise: a held-out error below it leaves nothing that more could be learnt from."""
SIMPLER: Final = 1.05
"""A simpler model within this factor of the best is preferred."""
COMPARED: Final = "gradient boosting"
"""Only compared, never served: its trees are no plain numbers."""
NEEDS: Final = {"LSTM (report)": ("torch", "torch", "torch"), COMPARED: ("sklearn", "scikit-learn", "diagnose")}
"""Module, package and extra of models that not every machine can fit."""
ORDER: Final = ("new configuration", "other day", "same configuration")


@dataclass
class Comparison:
    """What came of it.

    Args:
        models: fitted; scores: by name; seconds: of each fit; walls: shares of the time on the wrong side, reported and
            corrected, by model.
        noise_m: rms of the tracker's noise, three axes together.
    """

    learn: list[DeflectionSet]
    held: dict[str, list[DeflectionSet]]
    noise_m: float
    models: dict[str, DeflectionModel] = field(default_factory=dict)
    scores: dict[str, Score] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    walls: dict[str, tuple[float, float]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    best: str = ""
    reason: str = ""

    def figure(self, name: str) -> float:
        """The held-out error that counts: at new configurations, if there are any."""
        rmse = self.scores[name].rmse
        return next((rmse[kind] for kind in ORDER if kind in rmse), float("nan"))

    @property
    def doubts(self) -> list[str]:
        """Why the recommendation is not to be relied on, one line each with what to record next; empty when it is."""
        served = [n for n in self.models if n != COMPARED]
        error, lines = self.figure(self.best), []
        if not self.held:
            return ["no set was held out: how good it is is not known; record a second set at each of four places"]
        times, places = error / self.noise_m, len({s.configuration for s in self.learn})
        if not times <= ENOUGH:
            wanted = (
                "longer holds and all axes both ways" if places >= 4 else "four or more configurations, two sets each"
            )
            lines.append(
                f"what is left is {times:.1f} times the tracker's noise: the model misses some; record {wanted}"
            )
        rivals = [n for n in served if n != self.best]
        rival = min(rivals, key=self.figure, default=None)
        # Two errors within the noise of one another: their squares, as errors add, differ by less than the uncertainty
        # of a mean square over so many samples (three axes each).
        if rival is not None:
            samples = sum(len(s) for s in self.held[self.judged_on])
            unsure = 2.0 * max(error, self.noise_m) ** 2 * np.sqrt(2.0 / (3.0 * samples)) * np.sqrt(2.0)
            if abs(self.figure(rival) ** 2 - error**2) <= unsure:
                text = f"{self.best} and {rival} cannot be told apart by these held-out sets"
                lines.append(f"{text}: record more sets at configurations that are new")
        return lines

    @property
    def judged_on(self) -> str:
        """Which kind of held-out sets decides."""
        return next((kind for kind in ORDER if kind in self.held), "nothing")


def compare(
    learn: list[DeflectionSet],
    held: dict[str, list[DeflectionSet]],
    names: Sequence[str] = tuple(MODELS),
    say: Callable[[str], None] = lambda _: None,
) -> Comparison:
    """Fit and judge the models by name, those whose libraries are installed."""
    noise = noise_of(learn)[:3]
    out = Comparison(learn, held, float(np.sqrt(np.sum(noise**2))))
    for name in names:
        if missing := _missing(name):
            out.notes.append(missing)
            continue
        say(name)
        begin = time.perf_counter()
        out.models[name] = model_class(name)().fit(learn)
        out.seconds[name] = time.perf_counter() - begin
        out.scores[name] = judge(out.models[name], held)
        shares = [wall_shares(s, out.scores[name].predicted[s.name]) for sets in held.values() for s in sets]
        out.walls[name] = tuple(np.mean(shares, axis=0).tolist()) if shares else (float("nan"),) * 2
    out.best, out.reason = _recommend(out)
    return out


def _missing(name: str) -> str:
    """What is not installed for a model, and how it is; empty where it can be fitted."""
    module, package, extra = NEEDS.get(name, ("", "", ""))
    if not module or importlib.util.find_spec(module) is not None:
        return ""
    return f"{name} left out: {package} is not installed; pip install 'galen-hw[{extra}]'"


def require_served(names: Sequence[str]) -> None:
    """See that one of the models can be recommended, before minutes are spent on the others.

    Raises:
        UsageError: none of them.
    """
    if all(name == COMPARED or _missing(name) for name in names):
        why = [_missing(name) or f"{name} is never recommended" for name in names]
        raise UsageError("; ".join(why), where="--models", todo="name another model too")


def _recommend(out: Comparison) -> tuple[str, str]:
    """The served model with the least error; a simpler one where it is as good."""
    served = [n for n in out.models if n != COMPARED]
    error = {n: out.figure(n) for n in served}
    least = min(served, key=lambda n: error[n])
    best = next(n for n in served if error[n] <= SIMPLER * error[least])
    rival = min((n for n in served if n != best), key=lambda n: error[n], default=best)
    reason = f"{1e3 * error[best]:.3f} mm on held-out sets ({out.judged_on}), "
    reason += f"{error[best] / out.noise_m:.2f} x tracker noise"
    if rival != best and error[rival] > error[best]:
        reason += f"; next {rival}, {error[rival] / error[best]:.1f} x that"
    elif best != least:
        reason += f"; simpler than {least}, which is no better ({1e3 * error[least]:.3f} mm)"
    model = out.models[best]
    if isinstance(model, ElasticArm):
        reason += f"; kept: {', '.join(model.kept) or 'springs alone'}"
    return best, reason


def file_of(out: Comparison, name: str, robot: str, *, virtual: bool = False) -> DeflectionFile:
    """The recommended model for the service."""
    first = out.learn[0]
    predicted = out.scores[out.best].predicted
    pairs = [(s.give, predicted[s.name]) for sets in out.held.values() for s in sets]
    left = [give[:, : model.shape[1]] - model for give, model in pairs]
    std = np.nanstd(np.concatenate(left), axis=0).tolist() if left else []
    return DeflectionFile(
        name=name,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        software=VERSION,
        robot=robot,
        virtual=virtual,
        tool=first.tool,
        tip=tuple(first.observations.belief.tip.tolist()),
        model=out.best,
        values=out.models[out.best].to_json(),
        std=std,
        rmse_m=out.scores[out.best].rmse,
        data=[s.name for s in out.learn],
        reason=out.reason,
    )


def _judged(figure: float) -> float | None:
    """None where nothing was there to judge by: JSON knows no NaN."""
    return None if math.isnan(figure) else figure


def summary(out: Comparison) -> dict[str, Any]:
    """Plain values for --json."""
    rows: Mapping[str, Any] = {
        name: {
            "rmse_m": score.rmse,
            "times_noise": _judged(out.figure(name) / out.noise_m),
            "after_release_m": _judged(score.released),
            "residual_missed": _judged(score.residual),
            "wrong_side": dict(zip(("reported", "corrected"), map(_judged, out.walls[name]), strict=True)),
            "seconds": out.seconds[name],
        }
        for name, score in out.scores.items()
    }
    elastic = out.models.get("elastic arm")
    decisions = [vars(d) for d in elastic.decisions] if isinstance(elastic, ElasticArm) else []
    return {
        "learn": [s.name for s in out.learn],
        "held_out": {kind: [s.name for s in sets] for kind, sets in out.held.items()},
        "tracker_noise_m": out.noise_m,
        "models": rows,
        "recommended": out.best,
        "reason": out.reason,
        "notes": out.notes,
        "doubts": out.doubts,
        "decisions": decisions,
    }
