"""Everything a diagnosis went through, for reports and tests."""

from dataclasses import dataclass

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit import structure_test
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.validation.judgement import Judged


@dataclass
class Work:
    """Everything a diagnosis went through, for reports and tests; `structures`: what is left unexplained and matters."""

    bench: Bench
    selection: Selection
    model: Model
    judged: Judged
    structures: list[structure_test.Structure]
    diagnosis: Diagnosis
