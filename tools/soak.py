"""A long run of the whole daemon on a virtual robot, with faults at random and many listeners: `make soak`.

    python -m galen_hw.tools.soak [--minutes 60] [--seed 1] [--write docs/soak.md]

Ten listeners hear `wrench/compensated`, two of which never read (stuck: their queues fill, which must cost nobody else
anything). Faults are switched on and off on the wires at random; a sample counts as lost when a listener that reads misses
its number, or when the sensor's driver did not get it, outside the time of a fault and what follows it. A small process
beside it does nothing but sleep: when that is woken late, or the virtual robot says that it was, the machine has kept its
programs waiting, and what the driver then did not get is told apart. Each process' memory is read every few seconds; its
slope is that of a straight line through the second half of the run, and judged after half an hour only.
"""

import argparse
import math
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.daemon.session import own_daemon
from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.errors import EXIT_FOUND, EXIT_OK
from galen_hw.messages import Health, Status, WrenchCompensated

LISTENERS: Final = 10
STUCK: Final = 2
FAULTS: Final = ("ft.silent", "ft.lost_second@7", "ft.lost_first@11", "ft.late@50", "ft.reset", "motors.silent")
"""On the wires; those that this virtual robot does not have are left out."""
FAULT_S: Final = (0.2, 2.0)
BETWEEN_S: Final = (20.0, 60.0)
AFTER_S: Final = 8.0
"""What follows a fault: a sensor that was silent is identified and started again."""
LOOK_S: Final = 5.0
MINUTE_S: Final = 60.0
MOST_SLOPE: Final = 2e6
"""Bytes an hour that a process may grow by and still be called flat: a page table's noise over half an hour."""
ASKED_MINUTES: Final = 60.0
LEAST_S: Final = 1800.0
"""A run that is shorter says nothing of an hour's growth: buffers and caches still fill."""
STALL_S: Final = 0.02
SLEEPER: Final = f"""
import time
while True:
    before = time.monotonic()
    time.sleep(0.002)
    if (late := time.monotonic() - before - 0.002) > {STALL_S}:
        print(late, flush=True)
"""


@dataclass
class Story:
    """What happened.

    Args:
        lost: of the listeners that read, outside faults; wire: samples that the driver did not get, outside faults;
        stalled: of those, while the machine kept its programs waiting.
        stalls: how long it did so, s; load: averages of the last minute.
        faults: name, begin and end (monotonic s); memory: by process, pairs of time and bytes.
        minutes: p50 and p99 of the age of a wrench when it is published, s, and samples a second.
    """

    samples: int = 0
    lost: int = 0
    wire: int = 0
    stalled: int = 0
    stalls: list[float] = field(default_factory=list)
    load: list[float] = field(default_factory=list)
    stalled_at: float = -math.inf
    faults: list[tuple[str, float, float]] = field(default_factory=list)
    memory: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    minutes: list[tuple[float, float, float]] = field(default_factory=list)
    faulty_until: float = 0.0
    faulty: bool = False

    def excused(self, now: float) -> bool:
        """Return whether a loss now is one of an injected fault."""
        return self.faulty or now < self.faulty_until


def listen(addresses: Addresses, story: Story, end: threading.Event, *, stuck: bool) -> None:
    """Hear wrenches until the end, or never read one."""
    with Subscriber(addresses.bus, ("wrench/compensated",)) as subscriber:
        if stuck:
            end.wait()
            return
        last = -1
        while not end.is_set():
            received = subscriber.receive(0.5)
            if received is None or not isinstance(received[1], WrenchCompensated):
                continue
            message = received[1]
            if last >= 0 and message.seq > last + 1 and not story.excused(time.monotonic()):
                story.lost += message.seq - last - 1
            last = message.seq
            story.samples += 1


def watch_wire(addresses: Addresses, story: Story, end: threading.Event) -> None:
    """Count what the sensor's driver did not get, and keep percentiles by the minute."""
    ages: list[tuple[float, float, float]] = []
    until, before, told = time.monotonic() + MINUTE_S, -1, (0.0, 0)
    with Subscriber(addresses.bus, ("status", "health")) as subscriber, VirtualControl(addresses.virtual) as robot:
        while not end.is_set():
            received = subscriber.receive(0.5)
            now = time.monotonic()
            message = received[1] if received else None
            if isinstance(message, Status) and message.source == "ft":
                lost, seen = message.counters.get("lost", 0), (story.stalled_at, int(robot.state()["stalls"]))
                if 0 <= before < lost and not story.excused(now):
                    story.wire += lost - before
                    story.stalled += lost - before if seen != told else 0
                before, told = lost, seen
            elif isinstance(message, Health) and (wrench := message.topics.get("wrench/compensated")) is not None:
                ages.append((wrench.p50_s, wrench.p99_s, wrench.rate_hz))
            if now >= until and ages:
                until, found = now + MINUTE_S, np.array(ages)
                ages = []
                story.minutes.append(
                    (float(np.median(found[:, 0])), float(found[:, 1].max()), float(found[:, 2].mean()))
                )


def trouble(folder: Path, story: Story, end: threading.Event, seed: int) -> None:
    """Switch faults on and off at random."""
    chance = random.Random(seed)
    with VirtualControl(folder) as control:
        known = control.state()["known_faults"]
        faults = [name for name in FAULTS if name.partition("@")[0] in known]
        while faults and not end.wait(chance.uniform(*BETWEEN_S)):
            name = chance.choice(faults)
            begun, story.faulty = time.monotonic(), True
            control.fault(name)
            end.wait(chance.uniform(*FAULT_S))
            control.fault(name, on=False)
            now = time.monotonic()
            story.faulty_until, story.faulty = now + AFTER_S, False
            story.faults.append((name, begun, now))


def watch_machine(sleeper: "subprocess.Popen[str]", story: Story) -> None:
    """Take down each time that the sleeping process was woken late."""
    assert sleeper.stdout is not None
    for line in sleeper.stdout:
        story.stalls.append(float(line))
        story.stalled_at = time.monotonic()


def resident(pid: int) -> float:
    """Bytes of memory of a process, NaN when it is not there."""
    try:
        return float(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
    except (OSError, IndexError, ValueError):
        return math.nan


@contextmanager
def listeners(addresses: Addresses, story: Story, seed: int) -> Iterator[None]:
    """All that listens and troubles, for the time of the block."""
    end = threading.Event()
    jobs = [threading.Thread(target=watch_wire, args=(addresses, story, end))]
    jobs += [
        threading.Thread(target=listen, args=(addresses, story, end), kwargs={"stuck": n < STUCK})
        for n in range(LISTENERS)
    ]
    jobs.append(threading.Thread(target=trouble, args=(addresses.virtual, story, end, seed)))
    sleeper = subprocess.Popen([sys.executable, "-c", SLEEPER], text=True, stdout=subprocess.PIPE)
    jobs.append(threading.Thread(target=watch_machine, args=(sleeper, story)))
    for job in jobs:
        job.start()
    try:
        yield
    finally:
        end.set()
        sleeper.terminate()
        sleeper.wait()
        for job in jobs:
            job.join(10.0)


def run(seconds: float, seed: int) -> Story:
    """The whole run."""
    story = Story()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="galen-soak-")))
        addresses = stack.enter_context(own_daemon(runtime=folder / "run", state=folder / "state"))
        client = stack.enter_context(CommandClient(addresses.command))
        stack.enter_context(listeners(addresses, story, seed))
        begun = time.monotonic()
        while (passed := time.monotonic() - begun) < seconds:
            for name, pid in client.call("daemon", "info")["processes"].items():
                story.memory.setdefault(name, []).append((passed, resident(pid)))
            story.load.append(os.getloadavg()[0])
            time.sleep(min(LOOK_S, seconds - passed))
    return story


def slope(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Bytes an hour by which a process grew in the second half, and the standard error; NaN where that cannot be told."""
    found = np.array([p for p in points if not math.isnan(p[1])])
    found = found[len(found) // 2 :]
    if len(found) < 4:
        return math.nan, math.nan
    fitted, covariance = np.polyfit(found[:, 0], found[:, 1], 1, cov=True)
    return float(3600.0 * fitted[0]), float(3600.0 * math.sqrt(max(0.0, covariance[0, 0])))


def report(story: Story, seconds: float) -> tuple[str, bool]:
    """Markdown, and whether the promises were kept."""
    slopes = {name: slope(points) for name, points in sorted(story.memory.items())}
    judged = seconds >= LEAST_S
    grows = judged and any(value - 2.0 * error > MOST_SLOPE for value, error in slopes.values())
    good = not story.lost and story.wire == story.stalled and not grows
    lines = [
        _head(story, seconds),
        "",
        "| what | promised | measured |",
        "| --- | --- | --- |",
        f"| samples lost by a subscriber that reads, outside faults | 0 | {story.lost} of {story.samples} |",
        f"| samples that the driver did not get, outside faults | 0 | {story.wire - story.stalled} |",
        f"| the same while the machine kept its programs waiting | - | {story.stalled} |",
    ]
    for name, (value, error) in slopes.items():
        points = [p[1] for p in story.memory[name] if not math.isnan(p[1])]
        grown = f"{value / 1e6:+.2f} +- {error / 1e6:.2f} MB/h" if judged else "too short a run to tell a slope"
        lines.append(
            f"| memory of {name} | flat | {points[0] / 1e6:.1f} MB, at the end {points[-1] / 1e6:.1f} MB; {grown} |"
        )
    lines += ["", "| minute | p50 ms | p99 ms (worst second) | samples a second |", "| --- | --- | --- | --- |"]
    for n, (p50, p99, rate) in enumerate(story.minutes, start=1):
        lines.append(f"| {n} | {1e3 * p50:.3f} | {1e3 * p99:.3f} | {rate:.1f} |")
    return "\n".join(lines) + "\n", good


def _head(story: Story, seconds: float) -> str:
    """How long it was, and on what a machine."""
    asked = "" if seconds >= 60.0 * ASKED_MINUTES else f" (not the {ASKED_MINUTES:.0f} that are asked for)"
    load = f"{np.median(story.load):.1f}" if story.load else "unknown"
    stalls = f"{len(story.stalls)} times for {STALL_S * 1e3:.0f} ms or more"
    if story.stalls:
        stalls += f", {max(story.stalls):.2f} s at the longest"
    return (
        f"{seconds / 60:.3g} minutes{asked} at 1 kHz, {LISTENERS} subscribers, {STUCK} of them stuck, "
        f"{len(story.faults)} faults at random. {os.cpu_count()} cores, load average {load}; "
        f"the machine kept a sleeping program waiting {stalls}."
    )


def main(argv: list[str] | None = None) -> int:
    """Run, print, write; 1 if a promise was not kept."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=ASKED_MINUTES, help="how long (default: an hour)")
    parser.add_argument("--seed", type=int, default=1, help="of the faults")
    parser.add_argument("--write", type=Path, help="Markdown file")
    args = parser.parse_args(argv)
    seconds = 60.0 * args.minutes
    text, good = report(run(seconds, args.seed), seconds)
    print(text)
    if args.write is not None:
        args.write.write_text(f"# Soak\n\nWritten by `make soak`.\n\n{text}", encoding="utf-8")
    return EXIT_OK if good else EXIT_FOUND


if __name__ == "__main__":
    sys.exit(main())
