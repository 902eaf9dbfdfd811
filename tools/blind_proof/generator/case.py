"""What a case is: the plan of one recording and of what is hidden in it. This is the truth that is sealed."""

from dataclasses import asdict, dataclass, field
from typing import Any

SNR_LEVELS = (0.1, 0.2, 0.4, 0.8, 1.6)
"""rms of the effect over rms of the noise of one sample, over the channels that the effect touches."""


@dataclass
class Injected:
    """One concealed effect.

    Args:
        key: word of the vocabulary, or "unknown" for physics outside of it.
        kind: which physics made it, e.g. "warm-up" for drift; for the tables.
        snr: wanted severity; None where the size is what it is (wrong premises).
        amplitude: what the generator found to give that severity, in `unit`.
        channels, joints: where it shows; channels filled in from the data.
        parameters: numbers that a judge may compare with a finding's, by name.
        when: intervals in s for effects that come and go.
        machine: numbers that the machine has by its first run and keeps in all others.
        apart: how far it is from the nearest of the effect that it may be taken for, see `look_alikes`; None where not asked.
    """

    key: str
    kind: str
    snr: float | None = None
    amplitude: float = 0.0
    unit: str = ""
    channels: list[str] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)
    parameters: dict[str, float] = field(default_factory=dict)
    when: list[tuple[float, float]] = field(default_factory=list)
    machine: dict[str, float] = field(default_factory=dict)
    apart: float | None = None


@dataclass
class Case:
    """One recording to be made.

    Args:
        name: "case-0042"; seed: of everything random in it.
        group: which group is compared: "wrench", "pose", "targets", "effort" or "position".
        share: "null", "single", "several", "outside" or "premise".
        noise: "white", "coloured" or "quantised".
        motion: "stream" (moving all the time), "sweep" (poses, dwells, home returns), "sorted" (poses in one order).
        effects: what is concealed; empty for a null case.
        premise: what is wrong with the recording, for wrong-premise cases.
        mask: how the effect is masked, empty if it is not.
        encoder: rms of what the encoders' readings add to where the joints are, in rad.
    """

    name: str
    seed: int
    group: str
    share: str
    noise: str = "white"
    motion: str = "stream"
    rate_hz: float = 100.0
    duration_s: float = 120.0
    effects: list[Injected] = field(default_factory=list)
    premise: str = ""
    mask: str = ""
    bias_free: bool = True
    encoder: float = 0.0
    noise_rms: dict[str, float] = field(default_factory=dict)
    holdout_noise_rms: dict[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the sealed file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Case":
        """The case of a sealed file."""
        return cls(**{**values, "effects": [Injected(**e) for e in values["effects"]]})
