"""Which cases make up a set: the shares that the proof promises, drawn from one seed."""

import numpy as np

from galen_hw.tools.blind_proof.generator.arm import EFFORT_EFFECTS, POSITION_EFFECTS
from galen_hw.tools.blind_proof.generator.case import SNR_LEVELS, Case, Injected
from galen_hw.tools.blind_proof.generator.outside import OUTSIDE
from galen_hw.tools.blind_proof.generator.pose import EFFECTS as POSE_EFFECTS
from galen_hw.tools.blind_proof.generator.premises import PREMISES
from galen_hw.tools.blind_proof.generator.wrench import EFFECTS as WRENCH_EFFECTS

SHARES = {"null": 0.25, "single": 0.40, "several": 0.20, "outside": 0.10, "premise": 0.05}
NOISES = ("white", "coloured", "quantised")
TABLE = {
    "wrench": tuple(WRENCH_EFFECTS),
    "pose": tuple(POSE_EFFECTS),
    "effort": tuple(EFFORT_EFFECTS),
    "position": tuple(POSITION_EFFECTS),
}
SINGLES = [(group, key) for group, keys in TABLE.items() for key in keys]
NEVER_TOGETHER = (
    {"inertial", "payload"},
    {"compliance", "hardening"},
    {"compliance", "creep"},
    {"compliance", "hysteresis"},
)


def plan(seed: int, count: int) -> list[Case]:
    """`count` cases in the promised shares; every single effect at every severity comes round before any repeats."""
    rng = np.random.default_rng(seed)
    numbers = {share: round(count * part) for share, part in SHARES.items()}
    numbers["null"] += count - sum(numbers.values())
    grid = [(g, k, s) for s in SNR_LEVELS for g, k in SINGLES]
    order = rng.permutation(len(grid))
    cases: list[Case] = []
    for share, number in numbers.items():
        for i in range(number):
            case = _blank(rng, len(cases), share)
            if share == "single":
                group, key, snr = grid[order[i % len(grid)]]
                case.group = group
                case.effects = [Injected(key, key, float(snr))]
            elif share == "several":
                case.effects = _several(rng, case)
            elif share == "outside":
                name = str(rng.choice(list(OUTSIDE)))
                case.group, case.motion = "wrench", "stream"
                case.effects = [Injected("unknown", name, 1.0)]
            elif share == "premise":
                case.group, case.motion = "wrench", "stream"
                case.premise = PREMISES[i % len(PREMISES)]
            _mask(rng, case)
            if case.group == "position" and "joint_offset" in {e.key for e in case.effects}:
                case.bias_free = (
                    False  # A zero that is off is a constant here: it can be seen only where constants are not free.
                )
            case.rate_hz = 60.0 if case.group == "pose" else 100.0
            cases.append(case)
    return cases


ENCODERS = (0.0, 1e-5, 1e-4)
"""Rms of an encoder's jitter in rad: none, a fine one's, a magnetic one's."""


def _blank(rng: np.random.Generator, number: int, share: str) -> Case:
    """A case without effects."""
    group = str(rng.choice(["wrench", "pose", "effort", "position"], p=[0.5, 0.2, 0.2, 0.1]))
    return Case(
        name=f"case-{number:04d}",
        seed=int(rng.integers(2**31)),
        group=group,
        share=share,
        noise=str(rng.choice(NOISES)),
        motion=str(rng.choice(["stream", "sweep"], p=[0.7, 0.3])),
        bias_free=bool(group == "wrench" or rng.random() < 0.5),
        encoder=float(rng.choice(ENCODERS)),
    )


def _several(rng: np.random.Generator, case: Case) -> list[Injected]:
    """Two or three effects of one group, each at SNR 0.8, that do not exclude each other."""
    keys: list[str] = []
    while len(keys) < (2 if rng.random() < 0.7 else 3):
        key = str(rng.choice(TABLE[case.group]))
        clash = any({key, other} <= pair for other in keys for pair in NEVER_TOGETHER)
        if key not in keys and not clash:
            keys.append(key)
    return [Injected(k, k, 0.8) for k in keys]


def _mask(rng: np.random.Generator, case: Case) -> None:
    """A quarter of the cases where it can be done are masked."""
    keys = {e.key for e in case.effects}
    if case.share not in {"single", "several"} or rng.random() > 0.25:
        return
    if "temperature" in keys:
        case.mask = "temperature not recorded"
    elif "drift" in keys and case.group == "wrench":
        case.mask, case.motion = "poses ordered like gravity", "sorted"
    elif case.share == "single" and case.group == "wrench" and "payload" not in keys and "inertial" not in keys:
        case.mask = "under a bigger known effect"
        case.effects.append(Injected("payload", "payload", 6.0))
