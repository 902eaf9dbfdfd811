"""One averaged recording with its noise model, on which all hypotheses are scored.

All decisions are then small solves: inner products of whitened columns with each other and with the residual.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.signal_chain import OutputStage, through
from galen_hw.diagnosis.noise.estimator import estimate, quantisation
from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.settings import BUDGET
from galen_hw.diagnosis.stats.aliasing import Aliases
from galen_hw.diagnosis.stats.deadline import Deadline
from galen_hw.diagnosis.stats.linear_algebra import orthonormal, scaled, solve_sym
from galen_hw.diagnosis.stats.sampling import Index, Mask, Rows, blocks, set_aside
from galen_hw.lazy import cached_property
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.parameters import spacing
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import fading
from galen_hw.spatial import Array


@dataclass(frozen=True, eq=False)
class ModelState:
    """State that a model gives the data: replaced as a whole when another model is tried, and never changed.

    Args:
        y: (M, C) residual less the model's nonlinear remainders and `interaction`.
        stream: the scene with all that the model adds to its simulation.
        timing: output stage: delays, filters and limits with their parameters.
        interaction: (M, C) sum of the interaction terms of its effects: a gain scales a new load too.
        diverging: whether the interactions grow round after round: one part of the model cancels another.
    """

    y: Array
    stream: Scene
    timing: OutputStage = ()
    interaction: Array | float = 0.0
    diverging: bool = False


@dataclass
class Bench:
    """Hold one averaged recording with its noise model and the state of the present model.

    Args:
        scene: measured and simulated signals.
        held_share: share of held-out blocks.
        seed: of the choice of blocks and of surrogates.
        most: maximum number of rows; neighbours are averaged until there are no more.
        pose: period, s, from which rows are static poses of a sweep.
        in_order: number of rows without a clock from which their order shows the noise spectrum; averaged poses are fewer.
        deadline: of the searches on it; its copies have the same one.
    """

    scene: Scene
    held_share: float = 0.3
    seed: int = 0
    most: int = BUDGET.rows
    pose: float = field(default=1.0, kw_only=True)
    in_order: int = field(default=1000, kw_only=True)
    deadline: Deadline = field(default_factory=Deadline, kw_only=True)
    rows: Rows = field(init=False)
    block: Index = field(init=False)
    held_out: Mask = field(init=False)
    invalid_rows: Mask = field(init=False)
    without_data: Mask = field(init=False)
    """Channels (C,) that read one value in every row, as simulated, while others do not (a sensor without them)."""
    live_channels: int = field(init=False)
    """Number of channels with data: the others add no degree of freedom."""
    excluded_rows: Mask = field(init=False)
    aliases: Aliases = field(init=False)
    noise: Noise = field(init=False)
    state: ModelState = field(init=False)
    known_columns: dict[Effect, Hypothesis] = field(default_factory=dict)
    """See `cache_columns`."""

    def __post_init__(self) -> None:
        """Average the residual and choose the held-out blocks."""
        n = len(self.scene)
        # A scene that low-passes the compared signals says how many neighbouring rows are redundant.
        stride = max(1, self.scene.grain, -(-n // self.most))
        self.rows = Rows(tuple(self.scene.segments), stride, self.scene.cut)
        count = 40 if len(self.rows) >= 400 else max(min(len(self.rows) // 4, 14), 4)
        self.block = blocks(self.rows.runs, count)
        self.held_out = (
            set_aside(self.block, self.held_share, self.seed) if self.held_share > 0 else np.zeros(len(self.rows), bool)
        )
        still = np.ptp(self.scene.measured, axis=0) + np.ptp(self.scene.simulated, axis=0) == 0.0
        self.without_data = still & ~still.all()
        self.live_channels = int((~self.without_data).sum())
        self.whole = np.where(self.without_data, 0.0, self.rows.average(self.scene.residual))
        self.state = ModelState(self.whole, self.scene)
        self.steps = quantisation(self.scene.measured)
        self.width = len(self.scene.channels)
        self.leave_out(np.zeros(n, dtype=bool))

    def leave_out(self, outlier_rows: Mask) -> None:
        """Exclude rows (N,) and the recording's ends from all fits; interpolate the averaged rows that contain one."""
        self.outlier_rows = outlier_rows
        scene = self.scene
        self.aliases = Aliases(scene, self.rows, outlier_rows)
        self.invalid_rows = self.rows.spread(outlier_rows | scene.ends)
        self.excluded_rows = self.invalid_rows | self.rows.spread(scene.unanswered)
        good = np.flatnonzero(~self.invalid_rows)
        if self.invalid_rows.any() and len(good):
            at = np.arange(len(self.invalid_rows))
            self.whole = np.stack([np.interp(at, good, self.whole[good, c]) for c in range(self.width)], axis=-1)
        self.update_state(
            y=self.whole, stream=scene.carrying(np.median(self.whole[good], axis=0) if len(good) else 0.0, 0.0)
        )

    @property
    def y(self) -> Array:
        """Residual (M, C) that the present model's columns are fitted to."""
        return self.state.y

    @property
    def stream(self) -> Scene:
        """Scene with the present model's contribution."""
        return self.state.stream

    @property
    def timing(self) -> OutputStage:
        """Output stage of the present model: delays, filters and limits with their parameters."""
        return self.state.timing

    def update_state(self, **changes: Any) -> None:
        """Replace fields of the model state."""
        self.state = replace(self.state, **changes)

    @contextmanager
    def delivering(self, timing: OutputStage) -> Iterator[None]:
        """Deliver all columns through another output stage while the context lasts."""
        before = self.timing
        self.update_state(timing=timing)
        try:
            yield
        finally:
            self.update_state(timing=before)

    def restart_with(self, scene: Scene) -> None:
        """Use the same scene with another initial state."""
        self.scene = scene
        self.leave_out(self.outlier_rows)

    def reset(self) -> None:
        """Reset the model state, keeping the stream."""
        self.state = ModelState(self.whole, self.stream)

    @property
    def train(self) -> Mask:
        """Training rows (M,)."""
        return ~self.held_out & ~self.excluded_rows

    @property
    def judged(self) -> Mask:
        """Held-out rows (M,) that can be judged on."""
        return self.held_out & ~self.excluded_rows

    def average(self, x: Array) -> Array:
        """Return signals (N, ...) averaged on the bench's rows, (M, ...)."""
        return self.rows.average(x)

    def averaged(self, columns: Columns) -> Columns:
        """Return columns (N, c, k) averaged on the bench's rows, (M, c, k)."""
        return Columns(columns.channels, self.rows.average(columns.values))

    def hypothesis(self, effect: Effect, trials: int = 1) -> Hypothesis:
        """Return the hypothesis of an effect, with averaged columns; from the cache where it has them."""
        known = self.known_columns.get(effect) if trials == 1 and not through(effect, self.timing) else None
        return self.hypothesis_of(effect, self.raw(effect), trials) if known is None else known

    def cache_columns(self, hypotheses: Iterable[Hypothesis]) -> None:
        """Cache the columns of effects that do not depend on the stream, until the noise is learnt again."""
        each = ((h.effect, h) for h in hypotheses)
        self.known_columns = {e: h for e, h in each if e is not None and (not e.DOWNSTREAM or e.CLOCK)}

    def raw(self, effect: Effect) -> Columns:
        """Return an effect's averaged columns, passed through the output stage: delays, filters and limits."""
        ends = through(effect, self.timing)
        if not ends:
            known = self.known_columns.get(effect)
            return effect.averaged(self.scene_of(effect), self.rows.average) if known is None else known.raw
        columns = effect.columns(self.scene_of(effect))
        for downstream, theta in ends[:-1]:
            columns = downstream.delivered(self.stream, columns, theta)
        last, theta = ends[-1]
        return last.delivered_on(self, self.stream, columns, theta)

    @property
    def spacing(self) -> float:
        """Nominal period of the averaged rows, s."""
        return spacing(self.scene) * self.rows.stride

    def late(self, x: Array, seconds: float, *, bowed: bool = False) -> Array:
        """Return averages (M, ...) of signals (N, ...) delayed by seconds, see `operators.delay`."""
        if self.scene.even:
            return self.rows.late(x, [seconds / step for step in self.scene.steps], bowed=bowed)
        flat = self.stream.delay("delay", x.reshape(len(x), -1), seconds, bowed=bowed)
        return self.rows.average(flat).reshape(-1, *x.shape[1:])

    @cached_property
    def time(self) -> Array:
        """Averaged clock (M,), s, or the row number without a clock."""
        return self.rows.average(self.scene.time)

    @cached_property
    def period(self) -> float:
        """Median period of the averaged rows, s."""
        return float(np.median(np.diff(self.time))) if len(self.rows) > 1 else 1.0

    @cached_property
    def simulated(self) -> Array:
        """Averaged simulated channels (M, C)."""
        return self.rows.average(self.scene.simulated)

    def scene_of(self, effect: Effect) -> Scene:
        """Return the scene on which an effect acts: of output stages the one with the model's contribution."""
        return self.stream if effect.DOWNSTREAM else self.scene

    def hypothesis_of(self, effect: Effect | None, raw: Columns, trials: int = 1, name: str = "") -> Hypothesis:
        """Return a hypothesis with given averaged columns."""
        return Hypothesis(effect, raw, None, trials, name, noise=self.noise)

    def constants(self) -> list[Columns]:
        """Return the columns of always fitted nuisances: channel offsets, baseline nuisances, initial transients."""
        ones = np.ones((len(self.rows), 1, 1))
        out = [Columns((c,), ones) for c in range(self.width)]
        everywhere = tuple(range(self.width))
        out += [Columns(everywhere, self.rows.average(n)[:, :, None]) for n in self.scene.nuisances()]
        return out + [Columns(channels, self.rows.average(x)[:, :, None]) for channels, x in fading(self.scene)]

    def learn_noise(self, hypotheses: Iterable[Columns], extra: Iterable[Columns] = (), *, above: float = 0.0) -> None:
        """Estimate the noise from the residual of a rich fit: leading directions of all columns per channel, and `extra` whole.

        Below `above` (cycles a row) the spectrum is not measured but continued from that frequency.
        """
        self.known_columns = {}
        constants, library = self.constants(), list(hypotheses)
        always = [*constants, *extra]
        M, good = len(self.rows), ~self.excluded_rows

        def residual_of(c: int) -> tuple[Array, Array]:
            whole = [_of(col, c) for col in always if c in col.channels]
            rich = [_of(col, c) for col in library if c in col.channels]
            Q = rich_basis(np.concatenate(whole, axis=1), rich, M)
            fit = Q @ solve_sym(Q[good].T @ Q[good], Q[good].T @ self.y[good, c][:, None])[:, 0]
            return np.where(good, self.y[:, c] - fit, 0.0), Q

        residual, basis = zip(
            *Parallel(n_jobs=2, require="sharedmem")(
                delayed(residual_of)(c) for c in np.flatnonzero(~self.without_data).tolist()
            ),
            strict=True,
        )
        rows, whole = self.rows, np.stack(residual, axis=-1)
        self.noise = estimate(
            whole,
            list(basis),
            rows,
            ordered=self.ordered,
            static_poses=self.static_poses,
            steps=self.steps[~self.without_data],
            above=above,
        ).padded(self.without_data)

    @property
    def detectable(self) -> Array:
        """Smallest detectable rms (C,) of an effect in one channel alone; of a slow effect where the noise is slow.

        Half the log-likelihood ratio required of the best of a library is about 14.
        """
        variance = np.maximum(self.noise.slow, self.noise.sigma**2)
        return np.asarray(np.sqrt(2.0 * 14.0 / max(int(self.train.sum()), 1) * variance))

    @property
    def ordered(self) -> bool:
        """Whether the noise of successive rows may be correlated: on a clock, or in sufficiently many ordered rows."""
        return self.scene.clock or len(self.rows) >= self.in_order

    @property
    def static_poses(self) -> bool:
        """Whether each row is a separate static pose, held for a second or for an unknown time."""
        return not self.scene.clock or self.spacing >= self.pose

    def motion_band(self, *, most: float = 0.995) -> float:
        """Return the frequency, cycles a row, below which nearly all of the motion and its products lies; 0 without motion.

        Args:
            most: share of the power that counts as nearly all.
        """
        scene = self.scene
        moving = [scene.joint_index(joint) for joint in scene.moved]
        run = max(self.rows.runs, key=lambda r: r.stop - r.start)
        n = run.stop - run.start
        if not scene.clock or not moving or n < 64:
            return 0.0
        x = self.rows.average(scene.rates[0][:, moving])[run]
        power = np.abs(np.fft.rfft(x * np.hanning(n)[:, None], axis=0)) ** 2
        share = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), 1e-300)
        reach = int(np.max(np.argmax(share > most, axis=0)))
        return float(min(2.0 * reach / n, 0.2))

    def whitened(self, y: Array) -> Array:
        """Return the whitened residual (M, C); invalid rows are interpolated first."""
        return self.noise.bridged(y, ~self.invalid_rows)

    def surrogates(self, count: int = BUDGET.surrogates) -> Array:
        """Return surrogates (M, C, count): whitened noise like this recording's, quantised where its channels are."""
        rng = np.random.default_rng(self.seed + 1)
        mix = np.linalg.cholesky(self.noise.correlation + 1e-6 * np.eye(self.width))
        z = rng.normal(size=(len(self.rows), count, self.width)) @ mix.T
        out = np.moveaxis(z, 1, 2).copy()
        for c in np.flatnonzero(self.steps > 0).tolist():
            if self.rows.stride > 1:
                continue
            step = self.steps[c]
            own = max(float(self.noise.sigma[c] ** 2 - step**2 / 12.0), 0.0) ** 0.5 / float(self.noise.sigma[c])
            coloured = self.noise.colour(out[:, c], c) * own
            simulated = self.simulated[:, [c]] + float(np.median(self.y[:, c]))
            read = np.round((simulated + coloured) / step) * step - simulated
            out[:, c] = self.noise.whiten(read, c)
        return out


def _of(columns: Columns, channel: int) -> Array:
    """Return columns (M, k) in a channel, without those that are rounding errors of other channels' columns.

    Scaled to unit length these would be arbitrary directions, and other ones on another processor.
    """
    size, own = np.linalg.norm(columns.values, axis=0), columns.channels.index(channel)
    return np.asarray(columns.values[:, own, size[own] > np.sqrt(np.finfo(float).eps) * size.max(axis=0)])


def rich_basis(whole: Array, rich: list[Array], rows: int) -> Array:
    """Return an orthonormal basis (M, r) of `whole` and the leading directions of `rich`, r at most a twelfth of the rows."""
    most = int(min(70, max(rows // 12, 4)))
    Q = orthonormal(scaled(whole))
    if not rich:
        return Q
    X = scaled(np.concatenate(rich, axis=1))
    X = scaled(X - Q @ (Q.T @ X), keep=1e-4)
    if not X.size:
        return Q
    P = orthonormal(X, most=most)
    # Orthogonalise again against rounding errors; QR keeps the order, the strongest first.
    return np.concatenate([Q, np.linalg.qr(P - Q @ (Q.T @ P))[0]], axis=1)
