"""What one sample costs the deflection service: processor time of `handle`, with every kind of term in the model.

python -m galen_hw.tools.benchmarks.sample [--samples 20000] [--json]

Springs, friction, creep, hardening and play in one arm under a load that goes to and fro, joint states every 25 samples.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.clock import TimeBase
from galen_hw.config.tool_file import Origin, ToolFile
from galen_hw.config.tool_store import ToolStore
from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.elastic_terms import Term, Weight
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import JointsState, Vector3, WrenchCompensated
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.compliance import Compliance, Hardening
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.services.deflection.service import DeflectionService
from galen_hw.services.deflection.settings import DeflectionSettings
from galen_hw.services.deflection.store import DeflectionFile, DeflectionStore
from galen_hw.services.service import ServiceContext
from galen_hw.spatial import Array

ROBOT: Final = GalenRobot()
BASE: Final = TimeBase(1_700_000_000_000_000_000)
MS: Final = 1_000_000
JOINTS_EVERY: Final = 25
TOOL: Final = "retractor"
TIP: Final = (0.045, 0.0, -0.140)
SPRINGS: Final = {"roll": 2e-3, "tilt": 3e-3, "structure.z": 3e-5}
"""Port to compliance, rad/(N m) and m/N."""


def main(argv: list[str] | None = None) -> int:
    """Measure and print a line or JSON."""
    parser = argparse.ArgumentParser(prog="bench_sample", description=__doc__)
    parser.add_argument("--samples", type=int, default=20000, help="1 ms apart")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    p50, p99 = np.percentile(spent_us(args.samples), [50.0, 99.0])
    if args.json:
        print(json.dumps({"samples": args.samples, "p50_us": float(p50), "p99_us": float(p99)}))
    else:
        print(f"pose/corrected, {args.samples} samples: p50 {p50:.0f} us, p99 {p99:.0f} us")
    return 0


def spent_us(count: int) -> Array:
    """(count,) processor time of each compensated wrench in the service, us."""
    out = np.zeros(count)
    with tempfile.TemporaryDirectory(prefix="galen-sample-") as folder:
        service = _service(Path(folder))
        for k in range(count):
            t_ns = (1 + k) * MS
            if k % JOINTS_EVERY == 0:
                service.handle("joints/state", _joints(t_ns), t_ns)
            message = _wrench(t_ns, (5.0 * float(np.sin(0.01 * k)), 2.0, 1.0))
            begin = time.thread_time_ns()
            service.handle("wrench/compensated", message, t_ns)
            out[k] = time.thread_time_ns() - begin
    return out / 1e3


def _service(folder: Path) -> DeflectionService:
    """With a tool in hand and a model for it, on a store of its own."""
    tools = ToolStore(folder)
    origin = Origin(date="2026-01-01", software="bench", robot="galen", method="bench", sensor_serial="")
    tools.save(ToolFile(name=TOOL, tip=TIP, mass=0.3, com=(0.03, 0.004, -0.06), origin=origin))
    tools.select(TOOL)
    file = DeflectionFile(
        name="arm", robot="galen", tool=TOOL, tip=TIP, model="elastic arm", values=arm_of_all().to_json()
    )
    DeflectionStore(folder).save(file)
    return DeflectionService("deflection", DeflectionSettings(), ServiceContext(ROBOT, BASE, folder))


def arm_of_all() -> ElasticArm:
    """Springs, friction in the tilt joint, creep, hardening and play: every kind of term that a model may have."""
    terms = (
        *(Term("compliance", place, Compliance("joint", place)) for place in SPRINGS),
        Term("hysteresis", "tilt", Hysteresis.of_load("tilt", (0.2,))),
        Term("creep", "roll", Creep(3.0, joint="roll")),
        Term("hardening", "tilt", Hardening("tilt", 2)),
        Term("play", "roll", Backlash("roll", None, 0.02)),
    )
    values = np.array([*SPRINGS.values(), 2.5e-3, 3e-4, -1e-4, 2e-4])
    made = ElasticArm(terms, values, np.diag((0.02 * values) ** 2), {"tilt": [(0.2, 0.8)]})
    made.floor, made.weight = np.full(3, 1e-5), Weight(0.3, (0.009, 0.0012, -0.018))
    return made


def _joints(t_ns: int) -> JointsState:
    names = ROBOT.joint_names
    zeros = dict.fromkeys(names, 0.0)
    place = dict(zip(names, (0.02, -0.01, 0.03, 0.4, -0.3), strict=True))
    return JointsState(
        timestamp=BASE.timestamp(t_ns), t_ns=t_ns, seq=0, valid=True, source="motors",
        position=place, velocity=zeros, effort=zeros,
    )  # fmt: skip


def _wrench(t_ns: int, force: tuple[float, float, float]) -> WrenchCompensated:
    """A push (N, sensor axes) at the tip."""
    torque = Vector3(*np.cross(TIP, force).tolist())
    return WrenchCompensated(
        timestamp=BASE.timestamp(t_ns), t_ns=t_ns, seq=0, valid=True, source="compensation",
        force=Vector3(*force), torque=torque, tool=TOOL, enabled=True,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
