#!/usr/bin/env bash
# atheris 3.0.0 (with numpy 2.3.5): code that is instrumented for coverage keeps the result of every comparison that is an array.
# `(x > y).sum()` of 1000 numbers takes another 1.1 kB with each call, for good; np.greater(x, y) takes nothing. A long run over
# numerical code ends at libFuzzer's bound of memory, and looks like a leak of what is fuzzed.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check atheris==3.0.0 numpy==2.3.5
mkdir "$work/code"
cat > "$work/code/compared.py" <<'PYTHON'
import numpy as np


def by_operator(x, y):
    return (x > y).sum()


def by_function(x, y):
    return np.greater(x, y).sum()
PYTHON
cd "$work/code"
"$work/venv/bin/python" - <<'PYTHON'
import gc
import sys
import tracemalloc

import atheris
import numpy as np

sys.path.insert(0, ".")
with atheris.instrument_imports(include=["compared"]):
    import compared

kept = {}
for name in ("by_operator", "by_function"):
    tracemalloc.start()
    for _ in range(1000):
        getattr(compared, name)(np.zeros(1000), np.ones(1000))
    gc.collect()
    kept[name] = tracemalloc.get_traced_memory()[0] / 1000.0
    tracemalloc.stop()
    print(f"{name}: {kept[name]:.1f} bytes kept of each call")
sys.exit(not (kept["by_operator"] > 1000.0 and kept["by_function"] < 10.0))
PYTHON
