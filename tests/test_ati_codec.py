"""The ATI codec against published frames, against cantools, and against itself."""

import json
import struct
from pathlib import Path

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import galen_hw.drivers
from galen_hw.drivers.ati_netcanoem import codec
from galen_hw.drivers.ati_netcanoem.codec import Op
from galen_hw.drivers.device import CanFrame

VECTORS = json.loads((Path(__file__).parent / "vectors/ati_netcanoem.json").read_text())["frames"]
DBC = cantools.database.load_file(Path(galen_hw.drivers.__file__).parent / "ati_netcanoem/ati_netcanoem.dbc")
counts = st.integers(-32768, 32767)


def vectors(key):
    return [pytest.param(v, id=v["what"]) for v in VECTORS if key in v]


def frames(vector):
    return [CanFrame(int(frame["id"], 16), bytes.fromhex(frame["data"])) for frame in vector["frames"]]


@pytest.mark.parametrize("vector", vectors("op"))
def test_requests_are_the_manuals_frames(vector):
    """Each request is encoded to the frame of the table."""
    assert [codec.request(vector["base_id"], Op[vector["op"]], bytes(vector.get("args", [])))] == frames(vector)


@pytest.mark.parametrize("vector", vectors("gauges"))
def test_samples_decode_and_encode(vector):
    """A sample's two frames give the status and the gauges of the table, and come back from them."""
    first, second = frames(vector)
    assert codec.decode_sample(first.data, second.data) == (vector["status"], tuple(vector["gauges"]))
    assert codec.encode_sample(vector["status"], tuple(vector["gauges"])) == (first.data, second.data)


@pytest.mark.parametrize(
    ("key", "decode"),
    [
        ("serial_number", codec.decode_serial_number),
        ("firmware", lambda data: list(codec.decode_firmware(data))),
        ("counts_per_unit", lambda data: list(codec.decode_counts_per_unit(data))),
        ("units", lambda data: list(codec.decode_unit_codes(data))),
        ("row", lambda data: [round(c, 5) for c in codec.decode_matrix_row(data)]),
    ],
)
def test_answers_decode(key, decode):
    """Each answer of the start means what the table says."""
    found = [vector for vector in VECTORS if key in vector]
    assert found
    for vector in found:
        assert decode(b"".join(frame.data for frame in frames(vector))) == vector[key]


def oracle(vector):
    """The frames of a vector as cantools reads them, at the base id of the DBC."""
    values = {}
    for frame in frames(vector):
        values |= DBC.decode_message(0x200 | frame.arbitration_id & 0xF, frame.data, decode_choices=False)
    return values


@pytest.mark.parametrize("vector", vectors("gauges"))
def test_cantools_reads_the_samples_alike(vector):
    """The DBC's decoding of each sample in the table agrees."""
    values = oracle(vector)
    assert values["status"] == vector["status"]
    assert [values[f"sg{gauge}"] for gauge in range(6)] == vector["gauges"]


@pytest.mark.parametrize("vector", vectors("row"))
def test_cantools_reads_the_matrix_alike(vector):
    """The DBC's decoding of a published matrix row agrees."""
    values = oracle(vector)
    assert codec.decode_matrix_row(b"".join(frame.data for frame in frames(vector))) == tuple(
        values[f"c{gauge}"] for gauge in range(6)
    )


@given(status=st.integers(0, 0xFFFF), gauges=st.tuples(*[counts] * 6))
def test_samples_survive_the_round_trip_and_cantools(status, gauges):
    """Any status and any counts: encode and decode are inverse, and cantools sees the same numbers."""
    first, second = codec.encode_sample(status, gauges)
    assert codec.decode_sample(first, second) == (status, gauges)
    values = DBC.decode_message("SG_A", first) | DBC.decode_message("SG_B", second)
    assert (values["status"], tuple(values[f"sg{gauge}"] for gauge in range(6))) == (status, gauges)


@given(st.binary(min_size=8, max_size=8))
def test_serial_numbers_are_always_printable(data):
    """Whatever the eight bytes, the serial number can be printed on one line."""
    text = codec.decode_serial_number(data)
    assert text.isprintable()
    assert text.isascii()


def test_status_bits_follow_the_manual():
    """Table 4.3: which bits are critical, and that reserved bits and the summary mean nothing."""
    critical = [bit for bit in range(16) if codec.CRITICAL_MASK >> bit & 1]
    assert critical == [1, 2, 3, 4, 5, 6, 7, 11, 12]
    assert codec.status_texts(1 << 15 | 1 << 13 | 1 << 10 | 1 << 9) == []
    assert len(codec.status_texts(0xFFFF)) == 12


def test_requests_refuse_what_the_board_does_not_know():
    """A base id of eight bits, or data where none belong, is our own mistake and raises."""
    with pytest.raises(ValueError, match="base id"):
        codec.request(0x80, Op.SAMPLE)
    with pytest.raises(ValueError, match="takes 0 data bytes"):
        codec.request(0x20, Op.SAMPLE, b"\0")
    with pytest.raises(ValueError, match="takes 1 data bytes"):
        codec.request(0x20, Op.MATRIX_ROW)


def test_unknown_unit_code_raises():
    """A unit code outside the manual is not guessed."""
    with pytest.raises(KeyError):
        codec.decode_unit_codes(b"\x07\x01")


@pytest.mark.parametrize(
    ("units", "factor"),
    [((1.0, 1.0), (1.0, 1.0)), ((4.4482216152605, 0.1129848290276167), (4.4482216152605, 0.1129848290276167))],
)
def test_matrix_goes_to_si(units, factor):
    """Rows are divided by the counts per unit and multiplied by the unit: force rows and torque rows each by their
    own."""
    rows = np.arange(36.0).reshape(6, 6)
    matrix = codec.si_matrix(rows, (1000, 50), units)
    np.testing.assert_allclose(matrix[:3], rows[:3] / 1000 * factor[0])
    np.testing.assert_allclose(matrix[3:], rows[3:] / 50 * factor[1])


def test_published_row_gives_a_plausible_torque():
    """The published odd gauges at full scale are about 2.6 N m by the published row and 1 000 000 counts per unit."""
    row = next(vector["row"] for vector in VECTORS if "row" in vector)
    full_scale = sum(abs(c) for c in row[1::2]) * 32767 / 1e6
    assert 2.0 < full_scale < 3.5


def test_dbc_is_of_the_default_base_id():
    """Identifiers and lengths in the DBC are those of the codec at base id 0x20."""
    for message in DBC.messages:
        opcode = message.frame_id - 0x200
        assert message.length == codec.REPLY_LENGTHS[opcode]
    assert struct.calcsize(codec.FIRST.format) == DBC.get_message_by_name("SG_A").length
