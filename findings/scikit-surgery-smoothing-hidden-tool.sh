#!/usr/bin/env bash
# scikit-surgerycore 0.8.3, "smoothing buffer": a tool that is hidden goes on moving. The mean leaves out what is NaN, so
# that each hidden frame drops the oldest position and the result runs after the last one; its quality is a mean too.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check scikit-surgerycore==0.8.3
"$work/venv/bin/python" - <<'PYTHON'
import sys
from types import SimpleNamespace
import numpy as np
from sksurgerycore.baseclasses.tracker import SKSBaseTracker


class Tracker(SKSBaseTracker):
    def close(self): ...
    def get_frame(self): ...
    def get_tool_descriptions(self): ...
    def start_tracking(self): ...
    def stop_tracking(self): ...


tracker = Tracker({"smoothing buffer": 4}, [SimpleNamespace(name="tool")])


def frame(x):
    rotation, quality = (np.zeros((1, 3)), 1.0) if np.isfinite(x) else (np.full((1, 3), np.nan), 0.0)
    translation = np.array([[x, 0.0 * x, 0.0 * x]])
    tracker.add_frame_to_buffer(["tool"], [0.0], [0], [rotation], [translation], [quality])
    *_, pose, qualities = tracker.get_smooth_frame(["tool"])
    return float(pose[0][0, 3]), float(qualities[0])


seen = [frame(float(x)) for x in range(4)]
hidden = [frame(np.nan) for _ in range(4)]
print("seen at 0, 1, 2, 3:   (position, quality)", seen)
print("then hidden, 4 times: (position, quality)", hidden)
sys.exit([x for x, _ in hidden[:3]] != [2.0, 2.5, 3.0])
PYTHON
