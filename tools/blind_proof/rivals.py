"""Rivals on the same cases: gradient boosting with lagged inputs, sparse regression (pysindy), an LSTM.

Each learns the residual of the first run from the recorded inputs and their past and predicts the second run's, with
usual settings; their error is compared with the tool's on the channels that the hidden effect touches. The residual is that of
the tool's own simulation: all begin from what the recorded joints say, none knows the path behind their encoders' noise.
"""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from galen_hw.diagnosis.preprocessing.checks import quiet
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.recording import read_recording
from galen_hw.recording.observations import observations_of

Array = NDArray[np.float64]
LAGS = (1, 2, 4, 8, 16, 32, 64)


# One core a case: beside another case the threads of the trees wait for one another for longer than they compute.
@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def errors(folder: Path, channels: list[str]) -> dict[str, list[float]]:
    """Held-out rms of each rival a channel (c,), in the channel's unit.

    Args:
        folder: the case, with its runs `train` and `test`; channels: columns of the group.
    """
    # The simulation that the tool begins from: of joints without their encoders' noise, where that meets the recording.
    scenes = {run: quiet(scene_of(observations_of(read_recording(folder / run)))) for run in ("train", "test")}
    runs = {run: _read(folder / run, simulated(scene, channels), channels) for run, scene in scenes.items()}
    (x, y), (x_test, y_test) = runs["train"], runs["test"]
    rows = judged_rows(scenes["test"])
    centre, scale = x.mean(axis=0), x.std(axis=0) + 1e-12
    x, x_test = (x - centre) / scale, (x_test - centre) / scale
    spread = y.std(axis=0) + 1e-15
    out: dict[str, list[float]] = {}
    for name, rival in (("gradient boosting", _boosting), ("pysindy", _sindy), ("LSTM", _lstm)):
        predicted = rival(x, y / spread, x_test) * spread
        out[name] = np.sqrt(np.mean((y_test - predicted)[rows] ** 2, axis=0)).tolist()
    return out


def judged_rows(scene: Scene) -> NDArray[np.bool_]:
    """(N,) rows of the second run that the tool is judged on, where no effect is of a moment.

    On others the noise alone decides between two that are the true formula to four digits. Where the tool finds a late stream it
    leaves out the first rows too, as many as it is late by.
    """
    return ~scene.ends


def simulated(scene: Scene, channels: list[str]) -> Array:
    """(N, c) what the tool simulates of a recording."""
    return scene.simulated[:, [scene.channels.index(name) for name in channels]]


def _read(folder: Path, baseline: Array, channels: list[str]) -> tuple[Array, Array]:
    """Inputs (N, p) and residual (N, c): joints, other inputs, and the rates of all."""
    table = pd.read_csv(folder / "recording.csv")
    t = table["time"].to_numpy()
    inputs = [c for c in table.columns if c not in {*channels, "time"}]
    values = table[inputs].to_numpy()
    window = 21
    rate = savgol_filter(values, window, 3, deriv=1, delta=float(t[1] - t[0]), axis=0)
    bend = savgol_filter(values, window, 3, deriv=2, delta=float(t[1] - t[0]), axis=0)
    return np.hstack([values, rate, bend]), table[channels].to_numpy() - baseline


def _lagged(x: Array, n: int) -> Array:
    """Inputs with their past."""
    return np.hstack([x] + [np.vstack([np.repeat(x[:1], k, axis=0), x[:-k]])[:, :n] for k in LAGS])


def _boosting(x: Array, y: Array, x_test: Array) -> Array:
    """Gradient boosting, one model a channel, inputs and their past."""
    n = x.shape[1] // 3 * 2
    a, b = _lagged(x, n)[::3], _lagged(x_test, n)
    fits = [
        HistGradientBoostingRegressor(max_iter=150, early_stopping=True, random_state=0).fit(a, c) for c in y[::3].T
    ]
    return np.stack([f.predict(b) for f in fits], axis=1)


def _sindy(x: Array, y: Array, x_test: Array) -> Array:
    """Sparse regression, second-order library of inputs and rates; the run's last third chooses the threshold."""
    import pysindy

    n = x.shape[1] // 3 * 2
    x, x_test, offset = x[::4, :n], x_test[:, :n], y.mean(axis=0)
    target, cut = y[::4] - offset, len(x) * 2 // 3
    best: tuple[float, Any] = (np.inf, None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # It warns when a threshold leaves nothing; the next one is then tried.
        for threshold in (0.02, 0.05, 0.1, 0.2):
            features = pysindy.PolynomialLibrary(degree=2).fit(x).transform(x)
            optimizer = pysindy.STLSQ(threshold=threshold, alpha=1.0).fit(features[:cut], target[:cut])
            error = float(np.mean((target[cut:] - optimizer.predict(features[cut:])) ** 2))
            best = min(best, (error, optimizer), key=lambda pair: pair[0])
        features = pysindy.PolynomialLibrary(degree=2).fit(x).transform(x_test)
        return np.asarray(best[1].predict(features) + offset)


def _lstm(x: Array, y: Array, x_test: Array) -> Array:
    """One layer of 32 units over windows of four seconds, Adam, 120 passes."""
    import torch

    torch.manual_seed(0)
    torch.set_num_threads(1)
    step, length = 4, 100
    a, b = (torch.tensor(v[::step], dtype=torch.float32) for v in (x, y))
    count = len(a) // length
    a, b = a[: count * length].reshape(count, length, -1), b[: count * length].reshape(count, length, -1)
    net = torch.nn.LSTM(a.shape[2], 32, batch_first=True)
    head = torch.nn.Linear(32, b.shape[2])
    optimizer = torch.optim.Adam([*net.parameters(), *head.parameters()], lr=5e-3, weight_decay=1e-5)
    for _ in range(120):
        optimizer.zero_grad()
        loss: Any = torch.nn.functional.mse_loss(head(net(a)[0])[:, 10:], b[:, 10:])
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        coarse = head(net(torch.tensor(x_test[::step], dtype=torch.float32)[None])[0])[0].numpy()
    rows = np.arange(len(x_test))
    return np.stack([np.interp(rows, rows[::step], c) for c in coarse.T], axis=1)
