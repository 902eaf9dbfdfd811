"""Figures of docs/deflection.md: all models on one generated robot, the report's 3, 4, 5, 7, 10 and 11 for each of them.

python -m galen_hw.tools.deflection.example docs/deflection --seed 4003
"""

import argparse
import sys
from pathlib import Path

from galen_hw.tools.deflection.figures import figures, png
from galen_hw.tools.deflection.fit import Comparison, compare
from galen_hw.tools.deflection.robots import GivingRobot

LEARN, JUDGE, FIRST_NEW = 4, 2, 5


def compared(seed: int) -> Comparison:
    """All models on a generated robot: two sets at each of four configurations to learn, three kinds to judge."""
    robot = GivingRobot.drawn(seed)
    held = {
        "same configuration": robot.sets(JUDGE, each=1, again=2),
        "new configuration": robot.sets(JUDGE, each=1, first=FIRST_NEW),
        "other day": robot.sets(JUDGE, each=1, day=1),
    }
    return compare(robot.sets(LEARN), held, say=lambda name: print(f"fitting {name}", file=sys.stderr))


def main(argv: list[str] | None = None) -> int:
    """Write the figures."""
    parser = argparse.ArgumentParser(description="figures of the deflection models on a generated robot")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=4003)
    args = parser.parse_args(argv)
    out = compared(args.seed)
    args.folder.mkdir(parents=True, exist_ok=True)
    for name, title, figure in figures(out):
        (args.folder / f"{name}.png").write_bytes(png(figure))
        print(f"{name}.png: {title}")
    present = [k for k, on in GivingRobot.drawn(args.seed).present.items() if on]
    print(f"robot {args.seed} has {', '.join(present) or 'springs alone'}; {out.best}: {out.reason}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
