#!/usr/bin/env bash
# python-can 4.6.1: `import can` alone loads asammdf where that is installed, and with it pandas and numpy, though no log is
# read: several times as many modules and as much time, in every process that only wants to send a frame.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
look() {
  "$work/venv/bin/python" -c '
import sys, time
began = time.process_time()
import can
print(sys.argv[1], f"{len(sys.modules)} modules, {time.process_time() - began:.2f} s of CPU, pandas loaded:", "pandas" in sys.modules)' "$1"
}
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check python-can==4.6.1
look "python-can alone:  " >/dev/null  # compiles
without=$(look "python-can alone:  ")
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check asammdf==8.8.28
look "beside asammdf:    " >/dev/null
with=$(look "beside asammdf:    ")
printf '%s\n%s\n' "$without" "$with"
[[ $without == *"loaded: False" && $with == *"loaded: True" ]]
