#!/usr/bin/env bash
# MuJoCo: a joint with frictionloss never stands still. Under a load far below its limit it creeps at 1.06e-3 s (with the
# default solreffriction and solimp) times load over inertia, whatever the limit: such data hold no standstill.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check mujoco==3.10.0
"$work/venv/bin/python" - <<'PYTHON'
import sys
import mujoco

XML = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint type="hinge" axis="0 0 1" frictionloss="{limit}"/><inertial pos="0 0 0" mass="1" diaginertia="0.5 0.5 0.5"/>
</body></worldbody></mujoco>"""
creeps = []
for limit in (1.0, 5.0, 50.0):
    for load in (0.2, 0.8):
        model = mujoco.MjModel.from_xml_string(XML.format(limit=limit))
        data = mujoco.MjData(model)
        data.qfrc_applied[0] = load
        for _ in range(5000):
            mujoco.mj_step(model, data)
        creeps.append(data.qvel[0] * 0.5 / load)
        print(f"limit {limit:4} N m, load {load} N m: {data.qvel[0]:.3e} rad/s, {creeps[-1]:.3e} s times load over inertia")
sys.exit(not all(abs(c - 1.056e-3) < 1e-5 for c in creeps))
PYTHON
