#!/usr/bin/env bash
# python-can 4.6.1: SqliteWriter (.db) closed right after a burst keeps a third of it; nothing is said. The same frames are all in
# a .log. Its thread is told to stop with the frames still in its queue. Leave the writer open until they are written.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check python-can==4.6.1
WORK="$work" "$work/venv/bin/python" - <<'PYTHON'
import os
import sys
import can

kept = {}
for kind in ("log", "db"):
    path = os.path.join(os.environ["WORK"], f"frames.{kind}")
    with can.Logger(path) as log:
        for i in range(1500):
            log(can.Message(timestamp=1000 + 1e-3 * i, arbitration_id=1, data=[i & 255], is_extended_id=False))
    with can.LogReader(path) as reader:
        kept[kind] = sum(1 for _ in reader)
    print(f".{kind}: {kept[kind]} frames of 1500")
sys.exit(not (kept["log"] == 1500 and kept["db"] < 1500))
PYTHON
