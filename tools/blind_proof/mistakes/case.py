"""What a case is: the kind of mistake, the recording it was made in, and what is true of it. This is sealed."""

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class Mistake:
    """One case.

    Args:
        name: "mistake-0042"; seed: of everything random in it; kind: key of `kinds.KINDS`; family: of `origins.FAMILIES`.
        command: what it is asked with, "diagnose", "calibrate" or "deflection".
        says, numbers, loads: see `kinds.Made`.
        effects: what a finding may rightly name in the recording without the mistake.
        load: true {"mass" kg, "com" m}, None where there is none; coulomb: greatest dry friction of a joint, N m.
    """

    name: str
    seed: list[int]
    kind: str
    family: str
    command: str
    says: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    loads: list[dict[str, Any]] = field(default_factory=list)
    effects: list[str] = field(default_factory=list)
    load: dict[str, Any] | None = None
    coulomb: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the sealed file."""
        return asdict(self)
