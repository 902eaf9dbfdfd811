"""Sensors on CAN that stream by themselves, two frames a sample: what holds for the driver and the virtual sensor of each."""

import random
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

import rft_sensor
import strain_sensor
from conformance.peer import virtual_run
from paired_peer import MS, ask, force, wrenches

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.iit_strain import IitStrain
from galen_hw.drivers.iit_strain import codec as strain
from galen_hw.drivers.robotous_rft import RobotousRft
from galen_hw.drivers.robotous_rft import codec as rft
from galen_hw.drivers.virtual.iit_strain import StrainSettings, VirtualIitStrain
from galen_hw.drivers.virtual.paired_sensor import NEVER_NS
from galen_hw.drivers.virtual.robotous_rft import RftSettings, VirtualRobotousRft
from galen_hw.drivers.virtual.world import World
from galen_hw.errors import CommandRejectedError

T0 = NS_PER_S


@dataclass(frozen=True)
class Kind:
    """One sensor.

    Args:
        driver: its class; made: module of the hand-made sensor; peer: the class there; virtual: the virtual one.
        unit: N and N m a count, (6,); serial_number: of the hand-made one; end: frame that stops it.
        begin, ask: data of the commands that start the stream and that read the serial number.
        sample: identifier and length of the frames of a sample; short: length of a second one that is cut short.
        noise: identifiers on and around it.
    """

    driver: Any
    made: Any
    peer: Any
    virtual: Any
    unit: np.ndarray
    serial_number: str
    end: CanFrame
    begin: tuple[int, ...]
    ask: tuple[int, ...]
    sample: tuple[tuple[int, int], tuple[int, int]]
    short: int
    noise: tuple[int, ...]

    def far(self):
        """A virtual sensor, idle, and its world."""
        world = World(seed=1)
        return self.virtual(self.virtual.Settings(), world), world

    def send(self, device, data, t=T0):
        """Give the virtual sensor a command; what it sends at once."""
        device.feed(CanFrame(self.end.arbitration_id, bytes(data).ljust(len(self.end.data), b"\0")), t)
        return device.poll(t)


KINDS = {
    "robotous_rft": Kind(
        RobotousRft,
        rft_sensor,
        rft_sensor.Sensor,
        VirtualRobotousRft,
        unit=1.0 / np.repeat([RftSettings().df, RftSettings().dt], 3),
        serial_number="S-0001",
        end=rft.command(0x64, rft.Command.STOP_OUTPUT),
        begin=(0x0B,),
        ask=(0x02,),
        sample=((1, 8), (2, 8)),
        short=6,
        noise=(1, 2, 0x64, 3),
    ),
    "iit_strain": Kind(
        IitStrain,
        strain_sensor,
        strain_sensor.Board,
        VirtualIitStrain,
        unit=np.array(StrainSettings().full_scales) / 0x8000,
        serial_number="SN042",
        end=strain.command(1, strain.Command.SET_TRANSMISSION, 1),
        begin=(0x07, 0),
        ask=(0x1A,),
        sample=((0x31A, 6), (0x31B, 6)),
        short=5,
        noise=(0x201, 0x210, 0x31A, 0x31B, 0x318, 0x123),
    ),
}

each = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def check_every_sample_is_whole(run, kind):
    """Feed on; each sample must be one the sensor sent, all axes of the same number, and a newer one each time."""
    feed, last = run.feed, [0.0]

    def watched(wire):
        outputs = feed(wire)
        for output in outputs:
            if isinstance(output, tuple) and output[0] == "wrench/raw":
                raw = [round(x) for x in np.array(force(output[1])) / kind.unit]
                assert len(set(raw)) == 1
                assert last[0] < raw[0] <= run.peer.number
                last[0] = raw[0]
        return outputs

    run.feed = watched


@each
@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32),
    rates=st.dictionaries(
        st.sampled_from(["drop", "double", "double_pair", "short", "foreign"]),
        st.sampled_from([0.01, 0.1, 0.3]),
        min_size=1,
    ),
    rate_hz=st.sampled_from([100, 200, 1000]),
)
def test_no_wrong_sample_whatever_happens_on_the_wire(kind, seed, rates, rate_hz):
    """Any mixture of lost, doubled, short and foreign frames: each sample is whole and newer than the last."""
    # Both kinds of doubling at once put eight frames into a period of 1 kHz: the sensor's own bus has no room for them.
    assume(rate_hz < 1000 or not {"double", "double_pair"} <= rates.keys())
    peer = kind.peer(rng=random.Random(seed))
    run = kind.made.run_of(peer, rate_hz=rate_hz).seconds(0.2)
    assert run.device.ready
    check_every_sample_is_whole(run, kind)
    peer.rates = rates
    run.seconds(0.5)
    peer.rates = {}
    run.seconds(2.5)
    assert run.device.ready


@each
@pytest.mark.parametrize(
    ("fault", "counter"),
    [("drop", "lost"), ("double", "doubled"), ("double_pair", "doubled"), ("short", "short"), ("foreign", "foreign")],
)
def test_each_fault_is_counted(kind, fault, counter):
    """Each kind of fault shows in its counter, and the samples go on."""
    run = kind.made.run_of(rate_hz=200).seconds(0.5)
    before = run.device.counters
    run.peer.rates = {fault: 0.1}
    run.seconds(1.0)
    assert run.device.counters[counter] > before[counter]
    assert run.device.counters["samples"] - before["samples"] > 120


@each
def test_frames_that_piled_up_have_lost_their_times(kind):
    """After the reader stalled for 60 ms what had piled up is counted as late, not published under a wrong time."""
    run = kind.made.run_of(rate_hz=1000).seconds(0.5)
    done = len(wrenches(run))
    run.now_ns += 60 * MS
    run.seconds(0.1)
    stamps = np.diff([sample.t_ns for sample in wrenches(run)[done - 1 :]])
    assert run.device.counters["late"] >= 100
    assert stamps[0] > 60 * MS
    assert stamps[1:].min() > 0.8 * MS


@each
def test_commands_that_the_wire_shows_and_frames_of_others_are_told_apart(kind):
    """An adapter's echo of a command and another host's command are echoes; any other identifier is foreign."""
    run = kind.made.run_of().seconds(0.5)
    before = run.device.counters
    run.feed(kind.end)
    run.feed(CanFrame(0x456, bytes(8)))
    after = run.device.counters
    assert {name for name in after if after[name] != before[name]} == {"echoes", "foreign"}


@each
@pytest.mark.parametrize("lost", [0, 1])
def test_a_stream_of_halves_is_a_fault_that_says_so(kind, lost):
    """Every first (or second) frame missing: no sample, and the fault names it; a stream that ended is another fault."""
    run = kind.made.run_of().seconds(0.5)
    run.spoil = lambda wire: [] if wire.arbitration_id == kind.sample[lost][0] and run.peer.streaming else [wire]
    run.seconds(0.8)
    assert "one of their two frames is missing" in run.messages("fault")[0].what


@each
def test_a_start_that_begins_amid_a_stream_stops_it_first(kind):
    """Found streaming, as after a crash: nothing of the old stream is taken for an answer or published."""
    run = kind.made.run_of(kind.peer(streaming=True), rate_hz=1000).seconds(1.0)
    assert run.device.ready
    begun = next(t_ns for t_ns, wire in run.sent if wire.data[: len(kind.begin)] == bytes(kind.begin))
    assert wrenches(run)[0].t_ns > begun


@each
def test_another_sensor_than_the_configured_one_is_refused(kind):
    """Its number stands in the fault, and what to change."""
    run = kind.made.run_of(serial_number="other").seconds(5.0)
    assert not run.device.ready
    assert wrenches(run) == []
    fault = run.messages("fault")[0]
    assert f"sensor {kind.serial_number} answers" in fault.what
    assert "serial_number" in fault.todo


@each
def test_stop_ends_the_stream_and_restart_begins_it(kind):
    """`restart` answers with the first sample; `stop` sends one command, and no zero is possible then."""
    run = kind.made.run_of().seconds(0.5)
    ask(run, "restart")
    run.seconds(0.5)
    assert run.replies[0].result == {"serial_number": kind.serial_number}
    assert run.device.stop(run.now_ns) == [kind.end]
    assert run.device.stop(run.now_ns) == []
    with pytest.raises(CommandRejectedError):
        ask(run, "zero")


@each
def test_the_sample_that_completes_a_zero_has_it(kind):
    """With a load on: from the first sample that says so each is zero, none before."""
    counts = (500, -300, 20, 100, 10, -70)
    key = "axes" if kind.peer is rft_sensor.Sensor else "counts"
    run = kind.made.run_of(kind.peer(**{key: counts})).seconds(0.5)
    ask(run, "zero", samples=20)
    run.seconds(0.5)
    assert run.replies[-1].error is None
    np.testing.assert_allclose(run.replies[-1].result["std_force_n"], 0.0, atol=1e-9)
    zeroed = [sample for sample in wrenches(run) if sample.zeroings == 1]
    assert zeroed
    np.testing.assert_allclose([force(sample) for sample in zeroed], 0.0, atol=1e-9)


@each
@settings(max_examples=50)
@given(data=st.data())
def test_any_frames_at_any_time_raise_nothing(kind, data):
    """Arbitrary frames on and around the sensor's identifiers, amid its own, are no exception."""
    one = st.tuples(st.sampled_from(kind.noise), st.binary(max_size=8), st.integers(0, 3 * MS))
    run = kind.made.run_of(rate_hz=1000).seconds(0.1)
    for identifier, content, wait_ns in data.draw(st.lists(one, max_size=150)):
        run.until(run.now_ns + wait_ns)
        run.feed(CanFrame(identifier, content))
    run.seconds(0.1)


@each
@pytest.mark.parametrize(
    "fault", ["lost_first", "lost_second", "short", "late", "doubled", "foreign", "silent", "nothing"]
)
def test_faults_of_the_virtual_stream(kind, fault):
    """Samples suffer as the fault's name says, answers to commands do not."""
    device, world = kind.far()
    first, second = kind.sample
    expected = {
        "lost_first": [second],
        "lost_second": [first],
        "short": [first, (second[0], kind.short)],
        "late": [first],
        "doubled": [first, second] * 2,
        "foreign": [(0x80, 0), first, second],
        "silent": [],
        "nothing": [first, second],
    }
    if fault != "nothing":
        world.faults.add(f"ft.{fault}")
    assert [(f.arbitration_id, len(f.data)) for f in kind.send(device, kind.begin)] == expected[fault]
    if fault == "late":
        device.feed(kind.end, T0 + 1)
        assert [f.arbitration_id for f in device.poll(T0 + 30 * MS)] == [second[0]]
    kind.send(device, kind.end.data, T0 + 40 * MS)
    device.poll(T0 + 100 * MS)
    assert bool(kind.send(device, kind.ask, T0 + NS_PER_S)) == (fault != "silent")


@each
def test_a_restart_ends_the_virtual_stream(kind):
    """The sensor comes back idle, as after power-up."""
    device, world = kind.far()
    kind.send(device, kind.begin)
    world.faults.add("ft.reset")
    assert device.poll(T0 + 20 * MS) == []
    assert device.wakeup_ns == NEVER_NS


@each
def test_a_host_that_slept_gets_the_last_samples_only(kind):
    """Ten at most after a pause of the event loop, in order, and the grid of time is kept."""
    device, _ = kind.far()
    kind.send(device, kind.begin)
    period_ns = device.wakeup_ns - T0
    assert len(device.poll(T0 + 100 * period_ns)) == 20
    assert device.wakeup_ns == T0 + 101 * period_ns


@each
@given(data=st.data())
def test_no_frame_upsets_the_virtual_sensor(kind, data):
    """Any traffic: no exception, and its number afterwards."""
    device, _ = kind.far()
    one = st.tuples(st.integers(0, 0x7FF) | st.sampled_from(kind.noise), st.binary(max_size=8))
    for k, (identifier, content) in enumerate(data.draw(st.lists(one, max_size=30))):
        device.feed(CanFrame(identifier, content), T0 + k)
        device.poll(T0 + k)
    kind.send(device, kind.end.data)
    device.poll(T0 + 10 * NS_PER_S)
    assert kind.send(device, kind.ask, T0 + 10 * NS_PER_S)


@each
def test_the_driver_reads_what_the_virtual_sensor_feels(kind):
    """Two readings of one protocol agree: the load and the offset, to a count; after `zero`, what has changed since."""
    world = World(seed=1)
    world.noise_scale = 0.0
    world.attach("retractor")
    device = kind.virtual(kind.virtual.Settings(), world)
    run = virtual_run(kind.driver, device, world).seconds(1.0)
    assert run.device.ready
    whole = world.load(run.now_ns) + kind.virtual.Settings().offset
    assert (np.abs(force(wrenches(run)[-1]) - whole) <= kind.unit).all()
    ask(run, "zero", samples=20)
    run.seconds(0.5)
    assert run.replies[-1].error is None
    before = world.load(run.now_ns)
    world.attach(None)
    run.seconds(0.1)
    assert (np.abs(force(wrenches(run)[-1]) - world.load(run.now_ns) + before) <= 2 * kind.unit).all()
