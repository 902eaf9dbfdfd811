"""The binary data record, read here with nothing but the data sheet's offsets."""

import struct

import pytest

from tests.galil_host import Host


def record_of(host, command="QR"):
    data = host.ask_raw(command)
    assert data[-1:] == b":"
    return data[:-1]


def test_size_header_and_terminator():
    """Five axes: 262 bytes that say so themselves, bit 7 and the I, T, S blocks, then a colon."""
    record = record_of(Host())

    assert len(record) == 82 + 36 * 5
    assert record[0] == 0x87
    assert record[1] == 0x1F
    assert struct.unpack_from("<H", record, 2) == (262,)


def test_four_axes_have_the_size_seen_on_a_dmc4143():
    """226 bytes, axis bits 0x0F."""
    joints = dict(zip("ABCD", ("carriage1", "carriage2", "roll", "tilt"), strict=True))
    axes = {letter: {"joint": joint, "counts_per_unit": 1e6} for letter, joint in joints.items()}
    record = record_of(Host({"baud_rate": 0, "echo": False, "axes": axes, "model": "DMC4143"}))

    assert (len(record), record[1]) == (226, 0x0F)


def test_axis_block_while_slewing_backwards():
    """Status bits, signed positions, error, 64 times the velocity and the user variable stand where they should."""
    host = Host()
    host.ask("SH;ZA ,77;PRB=-90000;SPB=10000;BGB", ms=1000)
    record = record_of(host)
    block = struct.unpack_from("<HBBiiiiiiHBBi", record, 82 + 36)
    status, switches, code, reference, position, error, auxiliary, velocity, torque, *_, user = block

    assert status == 1 << 15 | 1 << 14 | 1 << 7 | 1 << 5
    assert switches & 0b1100 == 0b1100
    assert code == 0
    assert reference - position == error == pytest.approx(-20, abs=1)
    assert auxiliary == position < -9000
    assert velocity == -64 * 10_000
    assert -32767 <= torque < 0
    assert user == 77


def test_motor_off_is_bit_0_and_target_is_code_1():
    """At power-up: off, absolute mode, stop code 1."""
    record = record_of(Host())
    status, _, code = struct.unpack_from("<HBB", record, 82)

    assert status & 1
    assert code == 1


def test_general_block():
    """Sample counter of 1024 a second, inputs, error code, amplifier word with both ELO bits."""
    host = Host()
    first = record_of(host)
    host.ask("XX", ms=998)
    host.world.faults.add("elo")
    second = record_of(host)
    ticks = struct.unpack_from("<H", second, 4)[0] - struct.unpack_from("<H", first, 4)[0]

    assert ticks == pytest.approx(1024, abs=2)
    assert first[6] == 0xFF
    assert second[6] == 0xBF
    assert second[50] == 1
    assert struct.unpack_from("<I", second, 52) == (1 << 24 | 1 << 25,)
    assert struct.unpack_from("<I", first, 52) == (0,)


def test_limit_polarity_is_that_of_the_unit():
    """One driver family reads 1 as clear, the other as hit: the unit is configured either way."""
    hit = Host({"baud_rate": 0, "echo": False, "limit_polarity": "one_is_hit"})

    assert record_of(Host())[84] & 0b1100 == 0b1100
    assert record_of(hit)[84] & 0b1100 == 0


@pytest.mark.parametrize(("blocks", "first", "axes", "size"), [
    ("A", 0x80, 0x01, 40), ("AC", 0x80, 0x05, 76), ("IE", 0x84, 0x10, 92), ("I", 0x84, 0, 56),
    ("ISTABCDE", 0x87, 0x1F, 262),
])  # fmt: skip
def test_selected_blocks(blocks, first, axes, size):
    """QR with a list returns these blocks only, and its header says which."""
    record = record_of(Host(), f"QR {blocks}")

    assert (record[0], record[1], struct.unpack_from("<H", record, 2)[0], len(record)) == (first, axes, size, size)


def test_a_record_may_hold_a_colon():
    """A position of 0x3A puts the terminator's byte inside: the record must be read by its length."""
    host = Host()
    host.ask("DP 58")

    assert record_of(host).count(b":") >= 3
