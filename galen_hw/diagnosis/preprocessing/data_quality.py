"""What the checks of a recording found."""

from dataclasses import dataclass, field

from galen_hw.physics.scenes.base import Scene
from galen_hw.premises import Action, Examination


@dataclass
class Premise:
    """What the guards say.

    Args:
        scene: without the rows that cannot be compared.
        notes: one line each.
        wrong: lines that make every finding worthless (axes, signs, units); channels they concern.
    """

    scene: Scene
    notes: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)

    def take(self, examination: Examination) -> None:
        """Take up what the premises say of the recording; what they claim as physics becomes a finding as well."""
        first = [r for r in examination.remarks if r.action is not Action.REFUSED]
        self.notes[:0] = [r.line for r in first] + [r.line for r in examination.refused]
        if examination.refused:
            # What is refused is the cause; what later checks see are its consequences.
            self.notes = [line for line in self.notes if line not in self.wrong]
            self.wrong = [r.line for r in examination.refused]
            self.channels = [c for r in examination.refused for c in r.columns]
