#!/usr/bin/env bash
# python-can 4.6.1: a frame stamped before the first one of a log (two buses, two clocks, a reordered queue) comes back with
# another time from .asc (its whole stamp is added once more), .blf and .log (the first frame's); nothing is said. .csv, .trc
# and .db keep it.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check python-can==4.6.1
WORK="$work" "$work/venv/bin/python" - <<'PYTHON'
import os
import sys
import can

stamps = (1000.5, 1000.4, 1000.6)
second = {}
for kind in ("asc", "blf", "log", "csv", "trc", "db"):
    path = os.path.join(os.environ["WORK"], f"frames.{kind}")
    with can.Logger(path) as log:
        for i, stamp in enumerate(stamps):
            log(can.Message(timestamp=stamp, arbitration_id=i, data=[i], is_extended_id=False))
    options = {"relative_timestamp": False} if kind == "asc" else {}
    back = [m.timestamp for m in can.LogReader(path, **options)]
    second[kind] = round(back[1] - back[0], 3)
    print(f".{kind}: second frame {second[kind]:+.3f} s after the first (written: -0.100), third {back[2] - back[0]:+.3f}")
wrong = {kind: second[kind] for kind in ("asc", "blf", "log")}
right = all(second[kind] == -0.1 for kind in ("csv", "trc", "db"))
sys.exit(not right or -0.1 in wrong.values())
PYTHON
