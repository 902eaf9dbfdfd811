"""What holds for every driver of the table DRIVERS: plain functions, each a claim about one `Case`."""

import ast
import inspect
import random
import re
import sys
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import msgspec
import pytest
from conformance.peer import Peer, Run, wire_of
from pydantic import ValidationError

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import CanFrame, Device
from galen_hw.errors import CommandRejectedError, WrongCommandError
from galen_hw.messages import TOPICS, Request

TIME_BASE = TimeBase(1_700_000_000_000_000_000)
CLOCKS = frozenset({"time", "datetime", "threading", "asyncio", "socket", "select", "serial", "can", "os", "random"})


@dataclass(frozen=True)
class Case:
    """One row of DRIVERS, and the script of its peer (empty: it can only be met with silence and noise)."""

    name: str
    cls: type[Device[Any]]
    script: list[dict[str, Any]]

    def device(self, **settings: Any) -> Device[Any]:
        return self.cls("dut", self.cls.Settings(**settings), TIME_BASE)  # type: ignore[attr-defined]

    def run(self, *, answered: bool = True, now_ns: int = 1_000_000_000) -> Run:
        return Run(self.device(), Peer(self.script if answered else []), now_ns)

    @property
    def on_can(self) -> bool:
        return self.cls.wire == "can"  # type: ignore[attr-defined]

    def noise(self, seed: int, count: int = 300) -> list[Any]:
        """Wires nobody should send: random ones, and the peer's own with bytes changed, cut or repeated."""
        rng = random.Random(seed)
        answers = [wire for entry in self.script for wire in map(wire_of, entry["reply"])]
        return [self._noise_wire(rng, answers) for _ in range(count)]

    def _noise_wire(self, rng: random.Random, answers: list[Any]) -> Any:
        base = rng.choice(answers) if answers and rng.random() < 0.7 else None
        if not self.on_can:
            raw = bytearray(base if base is not None else rng.randbytes(rng.randrange(1, 40)))
            _damage(rng, raw)
            return bytes(raw)
        identifier = base.arbitration_id if base is not None and rng.random() < 0.9 else rng.randrange(0x800)
        raw = bytearray(base.data if base is not None else rng.randbytes(rng.randrange(9)))
        _damage(rng, raw)
        return CanFrame(identifier, bytes(raw[:8]))


def _damage(rng: random.Random, raw: bytearray) -> None:
    for _ in range(rng.randrange(3)):
        if raw and rng.random() < 0.3:
            del raw[rng.randrange(len(raw))]
        elif raw:
            raw[rng.randrange(len(raw))] = rng.randrange(256)


def _plain(outputs: list[Any]) -> list[Any]:
    """Outputs as plain data, NaN made comparable."""
    return [repr(msgspec.to_builtins(output)) for output in outputs]


def check_made_from_defaults(case: Case) -> None:
    """Default settings make a device; an unknown key does not; the wire is named; it rests until it is started."""
    device = case.device()
    assert device.name == "dut"
    assert case.cls.wire in ("can", "serial", "bota")  # type: ignore[attr-defined]
    try:
        case.device(no_such_key=1)
    except ValidationError:
        pass
    else:
        raise AssertionError("an unknown key is accepted")
    assert not device.ready
    assert device.poll(5) == ([], [])
    assert device.wakeup_ns > 10**15


def check_no_setting_is_infinite(case: Case) -> None:
    """TOML knows `inf` and `nan`; no setting of a device takes them (a time-out of `inf` is an OverflowError later)."""
    for key, field in case.cls.Settings.model_fields.items():  # type: ignore[attr-defined]
        if field.annotation is float:
            for value in (float("inf"), float("nan")):
                with pytest.raises(ValidationError):
                    case.cls.Settings(**{key: value})  # type: ignore[attr-defined]


def check_has_docstring(case: Case) -> None:
    """The class says what it publishes and which requests it takes."""
    assert case.cls.__doc__
    assert "`" in case.cls.__doc__


def check_noise_never_raises(case: Case) -> None:
    """Noise, alone or amid the answers of the peer, is no exception, and every message is of its topic's type."""
    for answered in (False, True):
        for seed in range(4):
            run = case.run(answered=answered).start()
            for wire in case.noise(seed):
                run.seconds(0.0007)
                run.feed(wire)
            run.seconds(2.0)
            for output in run.outputs:
                if isinstance(output, tuple):
                    assert isinstance(output[1], TOPICS[output[0]].message)


EXTREME_WORDS = (b"1e999", b"-1e999", b"nan", b"inf", b"9" * 1000, b"1_0", b"+", b"0x10", b"")
EXTREME_BYTES = (b"\0", b"\xff", b"\x7f\x80\0\0", b"\x7f\xff\xff\xff", b"\x80\0\0\0", b"\0\0\0\x01")


def _extremes(wire: Any) -> list[Any]:
    """The wire with each of its numbers put to an extreme: words of text, big-endian fields of a frame."""
    if isinstance(wire, CanFrame):
        # The first byte may say what it is an answer to.
        fields = [(head + pattern * 8)[: len(wire.data)] for pattern in EXTREME_BYTES for head in (b"", wire.data[:1])]
        return [CanFrame(wire.arbitration_id, field) for field in fields]
    return [re.sub(rb"(?<![A-Z])-?[0-9]+(\.[0-9]+)?", word, wire) for word in EXTREME_WORDS]


def check_extreme_numbers_never_raise(case: Case) -> None:
    """Each number of each answer at an extreme (1e999, a thousand digits, an infinite float) is no exception."""
    started = case.run().start().seconds(1.0)
    until_ready_s = 0.003 + max((t_ns for t_ns, _ in started.sent[: len(case.script) + 8]), default=0) / 1e9 - 1.0
    for place, entry in enumerate(case.script):
        for number, wire in enumerate(map(wire_of, entry["reply"])):
            for extreme in _extremes(wire):
                run = case.run()
                run.peer.changed = {(place, number): extreme}
                run.start().seconds(until_ready_s)


def check_recovers_from_noise(case: Case) -> None:
    """After noise a scripted peer brings the device back to ready."""
    if not case.script:
        return
    run = case.run().start()
    for wire in case.noise(9, 100):
        run.seconds(0.003)
        run.feed(wire)
    run.seconds(10.0)
    assert run.device.ready


def check_any_chunking_is_the_same(case: Case) -> None:
    """Bytes cut anywhere, one at a time or all at once, give the same outputs; frames give the same twice."""
    for seed in range(3):
        stream = case.noise(seed, 60)
        runs = [case.run(answered=False).start() for _ in range(3)]
        for run in runs:
            run.poll()
        if case.on_can:
            chunkings = [stream] * 3
        else:
            whole = b"".join(stream)
            cuts = sorted(random.Random(seed).randrange(len(whole)) for _ in range(40))
            pieces = [whole[a:b] for a, b in zip([0, *cuts], [*cuts, len(whole)], strict=True)]
            chunkings = [[whole], [bytes([byte]) for byte in whole], [piece for piece in pieces if piece]]
        for run, chunks in zip(runs, chunkings, strict=True):
            for chunk in chunks:
                run.feed(chunk)
        assert _plain(runs[0].outputs) == _plain(runs[1].outputs) == _plain(runs[2].outputs)
        assert runs[0].device.counters == runs[1].device.counters == runs[2].device.counters


def check_counters_only_grow(case: Case) -> None:
    """Counters are whole numbers with stable names; none ever falls, not even over a restart."""
    run = case.run().start()
    last = run.device.counters
    assert last
    for number, wire in enumerate(case.noise(3)):
        run.seconds(0.01)
        run.feed(wire)
        if number == 150:
            run.start()
        counters = run.device.counters
        assert set(last) <= set(counters)
        assert all(type(value) is int and value >= last.get(name, 0) for name, value in counters.items())
        last = counters


def check_wakeup_moves_on(case: Case) -> None:
    """After `poll` the next wake-up lies in the future, and 3 s take no more polls than a fast device has work for."""
    for answered in (False, True):
        run = case.run(answered=answered).start()
        for _ in range(2000):
            run.until(min(run.device.wakeup_ns, run.now_ns + 3_000_000))
            run.poll()
            assert run.device.wakeup_ns > run.now_ns
        run.polls = 0
        run.seconds(3.0)
        assert run.polls < 3 * 7000


def check_stop_leaves_it_at_rest(case: Case) -> None:
    """After `stop` nothing more is sent, it is not ready, and stopping again is fine; it can be started anew."""
    run = case.run().start().seconds(1.0)
    assert run.device.ready or not case.script
    run.peer.take(run.device.stop(run.now_ns), run.now_ns)
    before = len(run.sent)
    run.seconds(3.0)
    assert len(run.sent) == before
    assert not run.device.ready
    run.peer.take(run.device.stop(run.now_ns), run.now_ns)
    run.start().seconds(2.0)
    assert run.device.ready or not case.script


def check_unknown_request_is_rejected(case: Case) -> None:
    """A request it does not know raises, and sends nothing; so does every request before it is started."""
    run = case.run(answered=False)
    for name in ("no_such_request", "", "zero", "move_jp"):
        with pytest.raises(CommandRejectedError, match=r"\w"):
            run.device.request(Request(id="1", target="dut", name=name), run.now_ns)
    run.start()
    with pytest.raises(WrongCommandError, match="no_such_request"):
        run.device.request(Request(id="1", target="dut", name="no_such_request"), run.now_ns)
    assert run.sent == []


def check_unknown_arguments_are_rejected(case: Case) -> None:
    """No command is carried out with an argument that it does not take: a misspelt one would mean a default."""
    for name in ("zero", "unzero", "restart", "move_jp", "servo_jv", "enable", "disable", "clear_fault"):
        run = case.run().start().seconds(3.0)
        sent = len(run.sent)
        with pytest.raises(CommandRejectedError, match=r"\w"):
            run.device.request(Request(id="1", target="dut", name=name, args={"no_such_argument": 1}), run.now_ns)
        assert len(run.sent) == sent


def check_silence_becomes_a_fault(case: Case) -> None:
    """A peer that never answers: a fault that says what, where and what to do, at most once a second; never ready."""
    run = case.run(answered=False).start().seconds(20.0)
    assert not run.device.ready
    faults = run.messages("fault")
    assert faults
    assert all(fault.what and fault.where and fault.todo for fault in faults)
    for kind in {fault.what for fault in faults}:
        times = [fault.t_ns for fault in faults if fault.what == kind]
        assert all(b - a >= 1_000_000_000 for a, b in pairwise(times))


def check_status_every_second(case: Case) -> None:
    """A status at the start and then at least once a second, with the counters, and gauges that name their unit."""
    for answered in (False, True):
        run = case.run(answered=answered).start().seconds(5.5)
        times = [status.t_ns for status in run.messages("status")]
        assert len(times) >= 5
        assert all(b - a <= 1_100_000_000 for a, b in pairwise(times))
        last = run.messages("status")[-1]
        assert last.state in ("starting", "ready", "degraded", "fault", "stopped")
        assert last.counters
        assert all(name.endswith(("_hz", "_s", "_ns", "_m", "_rad", "_n", "_nm", "_k")) for name in last.gauges), last


def check_headers(case: Case) -> None:
    """Every message bears the device's name, a time that was handed in, and a number without gaps on its topic."""
    run = case.run().start().seconds(2.0)
    numbers: dict[str, int] = {}
    for output in run.outputs:
        if not isinstance(output, tuple):
            continue
        topic, message = output
        assert message.source == "dut"
        assert message.t_ns in run.times_ns
        assert message.timestamp == TIME_BASE.timestamp(message.t_ns)
        assert message.seq == numbers.get(topic, message.seq - 1) + 1
        numbers[topic] = message.seq
    assert "status" in numbers


def check_time_is_an_argument(case: Case) -> None:
    """Started at another time of the clock the same happens; the driver's modules import no clock, thread or port."""
    runs = [case.run(now_ns=t0).start() for t0 in (0, 123_456_789_000_000_000)]
    for run in runs:
        run.seconds(1.5)
    a, b = runs
    assert [wire for _, wire in a.sent] == [wire for _, wire in b.sent]
    assert [t - 0 for t, _ in a.sent] == [t - 123_456_789_000_000_000 for t, _ in b.sent]
    for name, module in list(sys.modules.items()):
        if not name.startswith("galen_hw.drivers.") or ".virtual" in name or not _is_part_of(case, name):
            continue
        for node in ast.walk(ast.parse(inspect.getsource(module))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.partition(".")[0] for name in names} & CLOCKS, f"{name} imports {names}"


def _is_part_of(case: Case, module: str) -> bool:
    """A driver's file or folder begins with the first word of its name; a transport or process of its own is the wire."""
    within = module.split(".")[2:]
    return within[0].startswith(case.name.partition("_")[0]) and not within[-1].endswith(("transport", "process"))


CHECKS = [value for key, value in sorted(globals().items()) if key.startswith("check_")]
