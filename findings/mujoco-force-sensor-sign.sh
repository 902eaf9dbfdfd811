#!/usr/bin/env bash
# MuJoCo's force and torque sensors give what the parent exerts on the site's body: a weight that hangs on it reads
# upwards. A force/torque sensor on an arm reads the weight downwards (docs/recording.md: turn all six signs).
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check mujoco==3.10.0
"$work/venv/bin/python" - <<'PYTHON'
import sys
import mujoco
import numpy as np

XML = """<mujoco><option gravity="0 0 -9.80665"/><worldbody><body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<body><inertial pos="0.1 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/><site name="s"/></body></body></worldbody>
<sensor><force site="s"/><torque site="s"/></sensor></mujoco>"""
model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
weight = np.array([0.0, 0.0, -0.5 * 9.80665])
acting = np.concatenate([weight, np.cross([0.1, 0.0, 0.0], weight)])
print("0.5 kg, 0.1 m along x, weigh    ", acting.round(4).tolist())
print("MuJoCo's force and torque sensors", data.sensordata.round(4).tolist())
sys.exit(not np.allclose(data.sensordata, -acting))
PYTHON
