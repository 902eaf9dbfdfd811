"""The report's net: one LSTM layer of 18 units, dropout 0.05, 150 iterations; trained by torch, served by numpy.

Source: Polevoy and Singh 2019, deflection by LSTM. The step runs in numpy, so that a service needs no torch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Self

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.features import now
from galen_hw.identification.deflection.model import DeflectionModel
from galen_hw.identification.deflection.stream import NONE, GiveStream, LinearStream, Place, Six, Triple
from galen_hw.spatial import Array

UNITS: Final = 18
DROPOUT: Final = 0.05
ITERATIONS: Final = 150
RATE_HZ: Final = 10.0
"""The net sees every sixth frame of a 60 Hz tracker: its memory then spans a push."""


@dataclass
class Lstm(DeflectionModel):
    """The net with its input and output scales; `weights` by torch's names."""

    NAME: ClassVar[str] = "LSTM (report)"
    ABOUT: ClassVar[str] = "one layer, 18 units, dropout 0.05, 150 iterations"
    weights: dict[str, Array] = field(default_factory=dict)
    centre: Array = field(default_factory=lambda: np.zeros(0))
    scale: Array = field(default_factory=lambda: np.ones(0))
    spread: Array = field(default_factory=lambda: np.ones(0))
    losses: list[float] = field(default_factory=list)
    """Mean square of the scaled error at every iteration of the training."""

    def fit(self, sets: Sequence[DeflectionSet]) -> Self:
        """Train on whole sets as sequences.

        Raises:
            UsageError: torch is not installed.
        """
        torch = _torch()
        x = [_thin(s, now(s)) for s in sets]
        y = [_thin(s, s.give) for s in sets]
        all_x, all_y = np.concatenate(x), np.concatenate(y)
        self.centre, self.scale = all_x.mean(axis=0), all_x.std(axis=0) + 1e-9
        self.spread = all_y.std(axis=0) + 1e-12
        torch.manual_seed(0)
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # The cell is small: more threads only wait for each other.
        layer, drop = torch.nn.LSTM(all_x.shape[1], UNITS, batch_first=True), torch.nn.Dropout(DROPOUT)
        head = torch.nn.Linear(UNITS, all_y.shape[1])
        optimizer = torch.optim.Adam([*layer.parameters(), *head.parameters()], lr=0.01)
        self.losses = []
        for _ in range(ITERATIONS):
            optimizer.zero_grad()
            self.losses.append(0.0)
            for a, b in zip(x, y, strict=True):
                inputs = torch.tensor((a - self.centre) / self.scale, dtype=torch.float32)[None]
                wanted = torch.tensor(b / self.spread, dtype=torch.float32)[None]
                loss = torch.nn.functional.mse_loss(head(drop(layer(inputs)[0])), wanted)
                loss.backward()
                self.losses[-1] += float(loss.detach()) / len(x)
            optimizer.step()
        torch.set_num_threads(threads)
        state = {**layer.state_dict(), **{f"head.{k}": v for k, v in head.state_dict().items()}}
        self.weights = {name: value.numpy().astype(float) for name, value in state.items()}
        return self

    def predict(self, data: DeflectionSet) -> Array:
        """Give (N, d), the net's coarse steps interpolated."""
        rows = _coarse_rows(data)
        inputs = (now(data)[rows] - self.centre) / self.scale
        hidden, cell = np.zeros(UNITS), np.zeros(UNITS)
        out = np.empty((len(rows), len(self.spread)))
        for k, row in enumerate(inputs):
            hidden, cell = self.step(row, hidden, cell)
            out[k] = (self.weights["head.weight"] @ hidden + self.weights["head.bias"]) * self.spread
        return np.stack([np.interp(np.arange(len(data)), rows, c) for c in out.T], axis=1)

    def step(self, row: Array, hidden: Array, cell: Array) -> tuple[Array, Array]:
        """One step of the cell (Hochreiter, Schmidhuber 1997), gates in torch's order: input, forget, cell, output."""
        w = self.weights
        gates = w["weight_ih_l0"] @ row + w["bias_ih_l0"] + w["weight_hh_l0"] @ hidden + w["bias_hh_l0"]
        i, f, o = (1.0 / (1.0 + np.exp(-gates[k * UNITS : (k + 1) * UNITS])) for k in (0, 1, 3))
        cell = f * cell + i * np.tanh(gates[2 * UNITS : 3 * UNITS])
        return o * np.tanh(cell), cell

    def to_json(self) -> dict[str, Any]:
        """Weights and scales."""
        weights = {name: value.tolist() for name, value in self.weights.items()}
        scales = {k: getattr(self, k).tolist() for k in ("centre", "scale", "spread")}
        return {"weights": weights, **scales}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """From weights and scales."""
        scales = {k: np.array(values[k]) for k in ("centre", "scale", "spread")}
        weights = {name: np.array(v) for name, v in values["weights"].items()}
        return cls(weights, scales["centre"], scales["scale"], scales["spread"])

    def stream(self, std: Array | None = None) -> GiveStream:
        """The net at its own pace; between its steps the last output stands."""
        return LstmStream(self, std)


class LstmStream(GiveStream):
    """The trained net sample by sample, in numpy."""

    def __init__(self, net: Lstm, std: Array | None = None) -> None:
        self._net, self._flat = net, LinearStream(np.zeros((0, 3)), std)
        self._q = np.zeros(len(net.centre) - 3)
        self._hidden, self._cell = np.zeros(UNITS), np.zeros(UNITS)
        self._next_s: float | None = None
        self._give: Six = NONE

    def place(self, place: Place) -> None:
        """The joints are inputs."""
        self._q = place.q

    def step(self, t_s: float, force: Triple, moment: Triple) -> Six:
        """One step of the net when its time has come."""
        del moment
        if self._next_s is None or t_s >= self._next_s:
            self._next_s = t_s + 1.0 / RATE_HZ
            net = self._net
            row = (np.array([*force, *self._q]) - net.centre) / net.scale
            self._hidden, self._cell = net.step(row, self._hidden, self._cell)
            out = (net.weights["head.weight"] @ self._hidden + net.weights["head.bias"]) * net.spread
            self._give = (*out.tolist(), *(0.0,) * (6 - len(out)))
        return self._give

    def covariance(self) -> list[float]:
        """The held-out error, the same everywhere."""
        return self._flat.covariance()

    def reset(self) -> None:
        """As at the start of a recording."""
        self._hidden, self._cell = np.zeros(UNITS), np.zeros(UNITS)
        self._next_s, self._give = None, NONE


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise UsageError(
            "training the LSTM needs torch", todo="pip install 'galen-hw[torch]', or leave it out"
        ) from error
    return torch


def _coarse_rows(data: DeflectionSet) -> Array:
    step = max(1, round(1.0 / (RATE_HZ * max(float(np.median(np.diff(data.time))), 1e-6))))
    return np.arange(0, len(data), step)  # type: ignore[return-value]


def _thin(data: DeflectionSet, values: Array) -> Array:
    return np.asarray(values[_coarse_rows(data)])
