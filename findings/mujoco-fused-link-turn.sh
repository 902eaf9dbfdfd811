#!/usr/bin/env bash
# MuJoCo 3.3.6 (at the latest) to 3.10.0: a URDF link that is fixed to its parent is fused into it (the default for URDF) without the turn
# and the offset of its joint, so that its mass lies elsewhere; nothing is said. 3.2.0 and 3.11.0 put it where it belongs.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for pinned in mujoco==3.2.0 mujoco==3.3.7 mujoco==3.10.0 mujoco==3.11.0; do
  version=${pinned##*==}
  python3 -m venv "$work/$version"
  "$work/$version/bin/python" -m pip install --quiet --disable-pip-version-check "$pinned"
  "$work/$version/bin/python" - <<'PYTHON'
import sys
import mujoco
import numpy as np

URDF = """<robot name="r">
<link name="base"/>
<link name="arm"><inertial><mass value="1"/><origin xyz="0.03 0 0"/><inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<link name="tool"><inertial><mass value="2"/><origin xyz="0.1 0 0"/><inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="f" type="fixed"><parent link="arm"/><child link="tool"/><origin xyz="0 0 0.2" rpy="0 0 1.5707963267948966"/></joint>
</robot>"""
model = mujoco.MjModel.from_xml_string(URDF)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
# 1 kg at (0.03, 0, 0) and 2 kg at (0, 0.1, 0.2): the tool's x axis is the arm's y axis.
right = np.array([0.01, 0.2 / 3, 0.4 / 3])
wrong = bool(np.abs(data.subtree_com[0] - right).max() > 1e-6)
print(mujoco.__version__, "centre of mass", data.subtree_com[0].round(4).tolist(), "not" if wrong else "as", right.round(4).tolist())
sys.exit(wrong != (mujoco.__version__ in ("3.3.7", "3.10.0")))
PYTHON
done
