"""The vendor's own driver over its dummy sensor, which needs no hardware: the process, the wire, and the whole daemon."""

import re
import time
from pathlib import Path

import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.daemon.port import Port, Waker
from galen_hw.daemon.session import own_daemon
from galen_hw.drivers.bota.codec import IDENTIFY, START, STOP, Frame, Sensor, decode
from galen_hw.drivers.bota.device import Bota
from galen_hw.drivers.bota_transport import BotaTransport, BotaWireSettings
from galen_hw.errors import HardwareError
from galen_hw.waiting import readable

pytest.importorskip("bota_driver", reason="bota-driver is not installed: pip install 'galen-hw[bota]'")

CONFIG = """
[devices.ft]
driver = "bota"
transport = { interface = "Bota_Dummy" }
[devices.ft.settings]
rate_hz = 10
[bus]
viewers = ""
[daemon]
realtime_priority = 0
"""


def processes() -> set[int]:
    """Processes of the vendor's driver on this machine that are alive."""
    found = set()
    for path in Path("/proc").glob("[0-9]*"):
        try:
            words, state = (path / "cmdline").read_bytes(), (path / "stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            continue
        if b"galen_hw.drivers.bota.process" in words and state != "Z":
            found.add(int(path.name))
    return found


def gone(pids: set[int], within_s: float = 10.0) -> bool:
    until = time.monotonic() + within_s
    while pids & processes() and time.monotonic() < until:
        time.sleep(0.02)
    return not pids & processes()


@pytest.fixture
def wire():
    made = BotaTransport(BotaWireSettings(interface="Bota_Dummy", silent_s=1.0))
    yield made
    made.close()


def lines(wire, seconds, *, at_least=1):
    """What is read in some seconds, or until there is enough."""
    until, found = time.monotonic() + seconds, []
    while time.monotonic() < until and len(found) < at_least:
        found += wire.receive(0.05)
    return found


def test_the_process_says_who_answers_and_streams_until_it_is_stopped(wire):
    """Ten frames a second with our stamps, each taken before it was read here; none after `stop`; then again."""
    wire.open()
    wire.send([STOP, IDENTIFY])
    ((line, _),) = lines(wire, 5.0)
    assert decode(line.rstrip(b"\n")) == Sensor("BFT-DUMMY-DUMMY-DUMMY", "SN000001", "v-dummy", 100_000)
    for _ in range(2):
        wire.send([START])
        begun_ns = time.monotonic_ns()
        got = lines(wire, 10.0, at_least=12)
        frames = [decode(line.rstrip(b"\n")) for line, _ in got]
        stamps = [t_ns for _, t_ns in got]
        assert all(isinstance(frame, Frame) and frame.status == 0 for frame in frames)
        assert stamps == sorted(stamps)
        assert begun_ns < stamps[0]
        assert stamps[-1] <= time.monotonic_ns()
        wire.send([STOP])
        lines(wire, 0.5, at_least=100)
        assert lines(wire, 0.5, at_least=100) == []


def test_no_process_outlives_its_wire(wire):
    """Closed while it streams, it brings the sensor to rest and ends by itself; the wire can be opened at once again."""
    before = processes()
    for _ in range(2):
        wire.open()
        wire.send([START])
        assert lines(wire, 10.0)
        wire.close()
    assert gone(processes() - before)


def test_a_process_that_dies_is_one_line_and_the_wire_comes_back(wire):
    """Killed as by a fault of the C++ library: what was read before it is handed over first."""
    wire.open()
    wire.send([START])
    assert lines(wire, 10.0)
    wire._process.kill()
    with pytest.raises(HardwareError, match="the vendor's driver has ended") as caught:
        lines(wire, 10.0, at_least=1000)
    assert caught.value.todo
    wire.open()
    wire.send([START])
    assert lines(wire, 10.0)


def test_a_sensor_that_gives_no_frame_ends_the_process():
    """A call that does not come back holds the interpreter's lock; the kernel ends it: 50 ms are too few for the dummy."""
    wire = BotaTransport(BotaWireSettings(interface="Bota_Dummy", silent_s=0.05))
    try:
        wire.open()
        wire.send([START])
        with pytest.raises(HardwareError, match="the sensor was silent for too long"):
            lines(wire, 20.0, at_least=1000)
    finally:
        wire.close()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"interface": "Bota_Binary", "address": "/dev/nonesuch"}, "No such file"),
        ({"interface": "Bota_CAN", "address": "nonesuch0"}, "nonesuch0"),
        ({"interface": "CANopen_over_EtherCAT", "address": "nonesuch0"}, "nonesuch0"),
        ({"interface": "Bota_Socket", "address": "127.0.0.1"}, "127.0.0.1"),
    ],
)
def test_a_sensor_that_is_not_there_is_a_line(keys, words):
    """In the package's own words, with what to do; nothing of it on our stdout, and no process is left."""
    before = processes()
    with pytest.raises(HardwareError, match=re.escape(words)) as caught:
        BotaTransport(BotaWireSettings(**keys)).open()
    assert "\n" not in str(caught.value)
    assert "\x1b" not in str(caught.value)
    assert gone(processes() - before)


@pytest.mark.live
def test_the_loop_is_never_held_up():
    """A turn of the daemon's loop over the dummy, whose frames are 100 ms apart: the longest takes less than half of that."""
    waker = Waker()
    device = Bota("ft", Bota.Settings(rate_hz=10.0), TimeBase.now())
    settings = BotaWireSettings(interface="Bota_Dummy")
    port = Port(device, lambda: BotaTransport(settings), time.monotonic_ns, waker.wake)
    until, longest_s, outputs = time.monotonic() + 20.0, 0.0, []
    try:
        while time.monotonic() < until and device.counters["samples"] < 15:
            wait_s = max(0.0, min(0.2, (port.wakeup_ns - time.monotonic_ns()) / NS_PER_S))
            ready = readable([waker.fd, *([port.fd] if port.fd is not None else [])], wait_s)
            if waker.fd in ready:
                waker.clear()
            begun = time.thread_time()
            outputs += port.step(readable=port.fd in ready)
            longest_s = max(longest_s, time.thread_time() - begun)
        assert device.counters["samples"] == 15
        assert longest_s < 0.05
        port.rest()
    finally:
        port.close()
        waker.close()


@pytest.mark.live
def test_the_daemon_publishes_valid_samples_of_the_dummy(tmp_path):
    """`galen-hw run` with nothing but the sensor: valid wrenches at its rate, our stamps in order; zero; no trace after."""
    before = processes()
    (tmp_path / "galen.toml").write_text(CONFIG)
    begun_ns = time.monotonic_ns()
    options = {"virtual": False, "runtime": tmp_path / "run", "state": tmp_path / "state"}
    with own_daemon(config=str(tmp_path / "galen.toml"), **options) as addresses:
        samples = []
        with Subscriber(addresses.bus, ["wrench/raw"]) as subscriber:
            until = time.monotonic() + 20.0
            while len(samples) < 40 and time.monotonic() < until:
                received = subscriber.receive(1.0)
                samples += [received[1]] if received is not None else []
        with CommandClient(addresses.command) as client:
            zeroed = client.call("ft", "zero", {"samples": 5}, 30.0)
            restarted = client.call("ft", "restart", {}, 30.0)
        mine = processes() - before
        assert mine
    stamps = [sample.t_ns for sample in samples]
    assert len(samples) == 40
    assert [sample.seq for sample in samples] == list(range(samples[0].seq, samples[0].seq + 40))
    assert sum(sample.valid for sample in samples) > 30  # a busy machine may hand one on too late
    assert stamps == sorted(set(stamps))
    assert begun_ns < stamps[0] < stamps[-1] < time.monotonic_ns()
    assert 7.0 < 39.0 * NS_PER_S / (stamps[-1] - stamps[0]) < 13.0
    assert {sample.serial_number for sample in samples} == {"SN000001"}
    assert abs(zeroed["bias_force_n"][0] - 1.0) < 0.5  # the dummy gives 1, 2, 3 N and some noise
    assert restarted == {"serial_number": "SN000001"}
    assert gone(mine)
