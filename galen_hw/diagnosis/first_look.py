"""A first look at a recording on few rows, so that what it finds is not taken for noise."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from galen_hw.diagnosis.detection import outliers
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.signal_chain import OutputStage, output_of
from galen_hw.diagnosis.lack_of_fit import structure_test
from galen_hw.diagnosis.searching import searched
from galen_hw.diagnosis.selection.moves.clock_offset import far_off
from galen_hw.diagnosis.selection.proposals import at_first_sight
from galen_hw.diagnosis.settings import BUDGET
from galen_hw.diagnosis.stats.deadline import Deadline
from galen_hw.diagnosis.validation.slow_noise import without_noise
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.events import Glitches
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import Beginning
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Known:
    """Result of a first look: effects with parameters, and kinds of structure by channel.

    step: between the rows of the first look, s; ends: late clocks, filters and limits that it goes through; stream: the scene
    with all that these effects add.
    """

    effects: list[tuple[Effect, Array]]
    structures: dict[int, str]
    step: float
    output_stage: OutputStage
    stream: Scene

    def alike(self, effects: Iterable[Effect], columns: Iterable[Columns]) -> list[Columns]:
        """Return the columns of all that acts in the joints in which something was found.

        On few rows it is not sure what that is, and what the other forms would explain must not pass for noise.

        Args:
            effects: of the library, with their columns.
        """
        joints = {joint for effect, _ in self.effects for joint in effect.joints}
        return [raw for effect, raw in zip(effects, columns, strict=True) if joints & set(effect.joints)]

    def learn_noise(
        self,
        effects: Iterable[Effect],
        columns: Iterable[Columns],
        bench: Bench,
        generic: list[structure_test.Family],
        also: Iterable[Columns] = (),
    ) -> None:
        """Learn the noise of a bench from the residual of what was found, of what acts in the same joints, and more.

        Args:
            effects: of the library, with their columns.
        """
        bench.learn_noise(self.alike(effects, columns), [*self.columns(bench, generic), *also])

    def columns(self, bench: Bench, generic: list[structure_test.Family], *, least: int = 12) -> list[Columns]:
        """Return columns, on the rows of a bench, of what must not be taken for noise, through the output stage.

        Args:
            least: rows for each direction that may be kept from passing for noise.
        """
        with bench.delivering(self.output_stage):
            out = [bench.raw(effect.relaxed) for effect, _ in self.effects]
            # Moments are known to within a row of the first look.
            step = self.step if self.step > bench.spacing else 0.0
            out += [bench.raw(more) for effect, _ in self.effects for more in effect.unshaped(step)]
            everywhere = tuple(range(bench.width))
            for effect, theta in self.effects:
                change = effect.exact(bench.scene, theta)
                if change is not None:
                    seen = output_of(bench.stream, effect, change, self.output_stage)
                    out.append(Columns(everywhere, bench.rows.average(seen)[:, :, None]))
        for channel, kind in self.structures.items():
            alike = [one.basis for one in generic if one.kind == kind]
            # In few rows all directions of a family would absorb too much of the noise, and be found again.
            most = max(len(bench.rows) // least // len(alike), 2)
            out += [Columns((channel,), basis[:, None, :most]) for basis in alike]
        return out


def benches(scene: Scene, held: float, seed: int, deadline: Deadline) -> tuple[Bench, Bench, list[Glitches]]:
    """Return the bench of the search, that of the first look, and the isolated samples that both exclude."""
    bench = Bench(scene, held, seed, deadline=deadline)
    coarse = Bench(scene, held, seed, BUDGET.coarse, deadline=deadline)
    glitch = outliers.marked(bench)
    coarse.leave_out(bench.outlier_rows)
    return bench, coarse, glitch


def effect_columns(effects: list[Effect], *benches: Bench) -> tuple[list[Effect], list[list[Columns]]]:
    """Return the effects of which this scene can tell what they do, and their columns on the rows of several of its benches.

    Without an orientation, say, nobody knows what another weight would read.
    """
    kinds: dict[type[Effect], dict[int, Effect]] = {}
    for place, effect in enumerate(effects):
        kinds.setdefault(type(effect), {})[place] = effect

    def of(kind: type[Effect], alike: dict[int, Effect]) -> dict[int, list[Columns]]:
        kind.ahead(benches[0].scene, list(alike.values()))
        whole = ((place, effect.columns(benches[0].scene_of(effect))) for place, effect in alike.items())
        return {place: [bench.averaged(columns) for bench in benches] for place, columns in whole}

    # The largest kind first: it takes as long as all others.
    work = sorted(kinds.items(), key=lambda one: -len(one[1]))
    done: dict[int, list[Columns]] = {}
    for part in Parallel(n_jobs=2, require="sharedmem", batch_size=1)(delayed(of)(*one) for one in work):
        done |= part
    finite = [k for k in range(len(effects)) if all(np.isfinite(columns.values).all() for columns in done[k])]
    return [effects[k] for k in finite], [[done[k][b] for k in finite] for b in range(len(benches))]


def first_look(bench: Bench, coarse: Bench, effects: list[Effect], columns: list[Columns], *, blind: bool) -> Known:
    """Search for effects and structure on few rows, with a noise level that is too low rather than too high."""
    generic = structure_test.families(coarse)
    seen = [coarse.raw(s.effect) for s in at_first_sight(bench)]
    extra, above = [*structure_test.leading_directions(coarse, generic), *seen], coarse.motion_band()
    coarse.learn_noise(columns, extra, above=above)
    ((_, model), *_), structures = searched(coarse, effects, columns, generic, blind=blind)
    coarse = model.bench
    if (shifts := far_off(model)) and not coarse.deadline.passed():
        # With a wrong clock no effect matched the measured signals: slow ones had passed for noise.
        late = [coarse.raw(effect) for effect in effects]
        coarse.reset()
        coarse.learn_noise(late, [*extra, *shifts], above=above)
        ((_, model), *_), structures = searched(coarse, effects, columns, generic, blind=blind)
        coarse = model.bench
    model = without_noise(model)
    if len(coarse.noise.edges):
        if not structures:
            # Fine structure passes for quick noise: only held-out blocks can show it, whatever the noise.
            coarse.noise = coarse.noise.flat()
            structures = _left(coarse, generic, model)
        if structures:
            # Slow noise passes for structure where the noise is too low: it has to be there beside all of the residual's noise.
            coarse.learn_noise([], [h.raw for h in model.parts])
            still = {one.channel for one in _left(coarse, generic, model)}
            structures = [one for one in structures if one.channel in still]
    return Known(
        model.placed(), {x.channel: x.kind for x in reversed(structures)}, coarse.spacing, coarse.timing, coarse.stream
    )


def _left(bench: Bench, generic: list[structure_test.Family], model: Model) -> list[structure_test.Structure]:
    """Return the structure in a model's residual under the present noise of its bench, which may be another than the model's."""
    residual = model.residual()
    plain = structure_test.Fitted([h.raw for h in model.parts], residual, bench.whitened(residual))
    (structures,) = structure_test.leftovers(bench, generic, [plain])
    return structures


def restarted(bench: Bench, known: Known, holdout: Scene | None) -> Scene | None:
    """Give the bench the stream of the first look and its initial state; return the held-out recording with that too."""
    every = [effect for effect, _ in known.effects]
    beginning = sum((e.beginning(bench.scene, theta, every) for e, theta in known.effects), Beginning())
    bench.restart_with(bench.scene.begun(beginning))
    bench.update_state(stream=known.stream)
    return None if holdout is None else holdout.begun(beginning)
