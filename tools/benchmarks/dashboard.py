"""What an open page of the dashboard adds to the way of a sample: one daemon, listened to without a page and with one, in turn.

    python -m galen_hw.tools.benchmarks.dashboard [--pairs 5] [--seconds 20]

The dashboard is the real command, its page a process that takes whatever the websocket gives. A browser on the same machine takes
more than that; what it takes is its own and not the daemon's.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from galen_hw.config.paths import Addresses
from galen_hw.daemon.session import own_daemon
from galen_hw.tools.benchmarks.latency import MOTORS, TEMPLATE, Result, listen

RATE_HZ = 1000.0


def main(argv: list[str] | None = None) -> int:
    """Print a line a pair, or (for this program itself) be a page."""
    parser = argparse.ArgumentParser(prog="bench_dashboard", description=__doc__)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each part of a pair")
    parser.add_argument("--page-of", metavar="HOST", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.page_of:
        _look(args.page_of)
        return 0
    for plain, opened in measure(args.pairs, args.seconds):
        print(f"p50 {plain.p50_us:.0f} -> {opened.p50_us:.0f} us, p99 {plain.p99_us:.0f} -> {opened.p99_us:.0f} us")
    return 0


def measure(pairs: int, seconds: float) -> list[tuple[Result, Result]]:
    """Return for each pair what a subscriber sees without a page and with one."""
    with tempfile.TemporaryDirectory(prefix="galen-bench-") as folder, ExitStack() as stack:
        config = Path(folder) / "galen.toml"
        words = {"driver": "ati_netcanoem", "rate": RATE_HZ, "priority": 20, "viewers": "", "motors": MOTORS}
        config.write_text(TEMPLATE.format(**words, more="[services.calibration]"), encoding="utf-8")
        daemon = own_daemon(config=str(config), runtime=Path(folder) / "run", state=Path(folder) / "state")
        addresses = stack.enter_context(daemon)
        found = []
        for _ in range(pairs):
            plain = listen(RATE_HZ, seconds, addresses)
            with _page(addresses):
                found.append((plain, listen(RATE_HZ, seconds, addresses)))
        return found


@contextmanager
def _page(addresses: Addresses) -> Iterator[None]:
    """A dashboard on any free port, and a page that is open on it."""
    words = ["dashboard", "--port", "0", "--look-only", "--dir", str(addresses.runtime)]
    with ExitStack() as stack:
        command = [sys.executable, "-m", "galen_hw.cli", *words]
        served = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(served.terminate)
        assert served.stdout is not None, "it is a pipe"
        host = served.stdout.readline().split("http://")[1].split("/")[0]
        look = [sys.executable, "-m", "galen_hw.tools.benchmarks.dashboard", "--page-of", host]
        stack.callback(stack.enter_context(subprocess.Popen(look, stderr=subprocess.DEVNULL)).terminate)
        yield


def _look(host: str) -> None:
    """Take whatever the websocket of a page gives."""
    from websockets.sync.client import connect
    from websockets.typing import Origin

    with connect(f"ws://{host}/live", origin=Origin(f"http://{host}"), compression=None) as page:
        for _ in page:
            pass


if __name__ == "__main__":
    sys.exit(main())
