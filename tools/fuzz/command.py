"""Runs the targets, each in a process with bounds of its own, and writes what came of it: `make fuzz`."""

import argparse
import importlib
import importlib.util
import json
import logging
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NoReturn

from galen_hw.tools.fuzz.mutate import LONGEST, mutated

MOST_DATA: Final = 1 << 30
"""Bytes of memory that the inputs of a target may take."""
LONGEST_S: Final = 10
"""Of one input; more is a hang."""
HEAD: Final = """# Fuzzing

Written by `make fuzz` (`python -m galen_hw.tools.fuzz.command`): whatever reads foreign bytes, each in a process whose inputs
may take {memory} MiB of memory, and {longest} s each. The targets are in `tools/fuzz/targets.py`; the same ones run with
Hypothesis in `tests/test_fuzz.py`. A *find* is anything but the program's own typed error: another exception, memory or time
beyond the bounds, a request or message above its bound, an old message that is still `valid`. What noise has done to a
device on its wire stays for the next input, as it would on a cable.

Asked for: {asked} inputs a target{capped}. Engine: {engine}.

| target | inputs | inputs/s | slowest input, ms | peak memory, MiB | finds |
| --- | --- | --- | --- | --- | --- |
"""


class Watched:
    """A target that counts, times and ends.

    Args:
        name: of the target; call: the target; inputs, seconds: after which it ends; engine: for the report.
    """

    def __init__(self, name: str, call: Callable[[bytes], None], inputs: int, seconds: float) -> None:
        self._name, self._call, self._left, self._seconds = name, call, inputs, seconds
        self._begun, self._count, self._slowest = time.monotonic(), 0, 0.0
        signal.signal(signal.SIGALRM, _too_long)

    def __call__(self, data: bytes) -> None:
        """One input."""
        begun = time.perf_counter()
        signal.alarm(LONGEST_S)
        try:
            self._call(data)
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is a find
            self._end("".join(traceback.format_exception(error)[-3:]), data)
        signal.alarm(0)
        self._count += 1
        self._slowest = max(self._slowest, time.perf_counter() - begun)
        if self._count >= self._left or time.monotonic() - self._begun > self._seconds:
            self._end("", b"")

    def _end(self, find: str, data: bytes) -> NoReturn:
        spent = time.monotonic() - self._begun
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        result = {"name": self._name, "inputs": self._count, "seconds": spent, "slowest_ms": 1e3 * self._slowest}
        print(json.dumps(result | {"peak_mib": peak, "find": find, "input": data.hex()}), flush=True)
        os._exit(1 if find else 0)


def reserved_bytes() -> int:
    """Return what this process has reserved of memory for data, as RLIMIT_DATA counts it, bytes."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith("VmData:"))


def run_one(name: str, inputs: int, seconds: float, seed: int) -> None:
    """Fuzz one target in this process, which ends with it."""
    atheris = _atheris()
    if atheris is None:
        from galen_hw.tools.fuzz.targets import TARGETS
    else:
        with atheris.instrument_imports(include=["galen_hw"]):
            from galen_hw.tools.fuzz.targets import TARGETS
    logging.disable()  # a target says what is wrong with each of its inputs
    target = TARGETS[name]
    watched = Watched(name, target.make(), inputs, seconds)
    if atheris is None:
        # What libraries have reserved when they were loaded counts too (pyarrow alone: most of a gigabyte, never touched).
        most = reserved_bytes() + MOST_DATA
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        rng = random.Random(seed)
        while True:
            watched(mutated(rng, target.seeds))
    corpus = Path(tempfile.mkdtemp(prefix="galen-hw-corpus-"))  # libFuzzer wants a folder, and never returns
    for number, content in enumerate(target.seeds):
        (corpus / str(number)).write_bytes(content)
    # What it finds stands in the answer; its own copies would lie about in the working folder.
    bounds = [f"-max_len={LONGEST}", f"-rss_limit_mb={MOST_DATA >> 20}", f"-artifact_prefix={corpus}/found-"]
    atheris.Setup([sys.argv[0], str(corpus), *bounds, f"-seed={seed}", "-verbosity=0"], watched)
    atheris.Fuzz()


def _atheris() -> Any:
    return importlib.import_module("atheris") if importlib.util.find_spec("atheris") else None


def _too_long(*_: object) -> NoReturn:
    raise TimeoutError(f"more than {LONGEST_S} s")


def _row(result: dict[str, Any]) -> str:
    rate = result["inputs"] / max(1e-9, result["seconds"])
    numbers = f"{result['inputs']} | {rate:.0f} | {result['slowest_ms']:.0f} | {result['peak_mib']:.0f}"
    return f"| {result['name']} | {numbers} | {1 if result['find'] else 0} |"


def _run_apart(name: str, args: argparse.Namespace) -> dict[str, Any]:
    words = ["--one", name, "--inputs", str(args.inputs), "--seconds", str(args.seconds), "--seed", str(args.seed)]
    command = [sys.executable, "-m", "galen_hw.tools.fuzz.command", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    for line in reversed(done.stdout.splitlines()):
        if line.startswith('{"name"'):
            return dict(json.loads(line))
    find = f"ended with status {done.returncode}: {done.stderr[-2000:]}"
    return {"name": name, "inputs": 0, "seconds": 0.0, "slowest_ms": 0.0, "peak_mib": 0.0, "find": find, "input": ""}


def main(argv: list[str] | None = None) -> int:
    """Fuzz every target, or those named; exit status 1 when something was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="of each target (default: a million)")
    parser.add_argument("--seconds", type=float, default=1e9, help="a target ends after so long, whatever its inputs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--target", action="append", metavar="NAME", help="only this one; may be repeated")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="targets at a time (default: every core)"
    )
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table there")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.one:
        run_one(args.one, args.inputs, args.seconds, args.seed)
    from galen_hw.tools.fuzz.targets import TARGETS  # a process of its own has it instrumented by then

    results = []
    with ThreadPoolExecutor(args.workers) as pool:
        for result in pool.map(lambda name: _run_apart(name, args), args.target or TARGETS):
            results.append(result)
            print(_row(result), flush=True)
            if result["find"]:
                print(result["find"], result["input"], sep="\n", flush=True)
    if args.write:
        engine = "atheris (coverage-guided)" if _atheris() else "mutations of our own (atheris is not installed)"
        capped = f", {args.seconds:g} s at most" if args.seconds < 1e9 else ""
        head = HEAD.format(memory=MOST_DATA >> 20, longest=LONGEST_S, asked=args.inputs, capped=capped, engine=engine)
        total = sum(result["inputs"] for result in results)
        rows = "\n".join(_row(result) for result in results)
        args.write.write_text(f"{head}{rows}\n\n{total} inputs in all.\n", encoding="utf-8")
    return 1 if any(result["find"] for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
