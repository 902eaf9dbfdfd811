"""The virtual tracker at its line: framing, session, replies, frames, faults; all times are given."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.drivers.virtual.ndi_tracker import VirtualNdiTracker
from galen_hw.drivers.virtual.ndi_tracker.scene import REFERENCE, TOOL
from galen_hw.drivers.virtual.ndi_tracker.wire import crc16, garble
from galen_hw.drivers.virtual.world import World
from galen_hw.spatial import quaternion_from_rotation
from tests.pty_peer import rom

MS = 1_000_000
PORT_LINE = 2 + 51 + 8 + 8 + 1


def command(text):
    return text.encode() + f"{crc16(text.encode()):04X}\r".encode()


class Host:
    """A host with its own clock."""

    def __init__(self, **options):
        options = {"paced": False, "announce": False} | options
        self.world = World()
        self.device = VirtualNdiTracker(VirtualNdiTracker.Settings(**options), self.world)
        self.now_ns = 10**9
        self.device.poll(self.now_ns)

    def raw(self, data, ms=2.0):
        self.device.feed(data, self.now_ns)
        return self.wait(ms)

    def wait(self, ms):
        self.now_ns += round(ms * MS)
        return b"".join(self.device.poll(self.now_ns))

    def ask(self, text, ms=2.0):
        reply = self.raw(command(text), ms)
        assert reply.endswith(b"\r")
        assert f"{crc16(reply[:-5]):04X}".encode() == reply[-5:-1]
        return reply[:-5].decode()

    def load(self, handle, data=None):
        data = (data or rom().read_bytes()).ljust(768, b"\0")
        for at in range(0, len(data), 64):
            assert self.ask(f"PVWR:{handle:02X}{at:04X}{data[at : at + 64].hex().upper()}", ms=30) == "OKAY"

    def track(self, count=2):
        assert self.ask("INIT:") == "OKAY"
        for handle in range(1, count + 1):
            assert self.ask("PHRQ:*********1****") == f"{handle:02X}"
            self.load(handle)
            assert self.ask(f"PINIT:{handle:02X}") == "OKAY"
            assert self.ask(f"PENA:{handle:02X}D") == "OKAY"
        assert self.ask("TSTART:80") == "OKAY"
        self.wait(100)
        return self

    def tx(self, option="0801"):
        """Per handle (text before the status, status, frame), and the system status."""
        text = self.ask(f"TX:{option}")
        *lines, system = text[2:].split("\n")
        assert len(lines) == int(text[:2], 16)
        return [(x[2:-16], int(x[-16:-8], 16), int(x[-8:], 16)) for x in lines], int(system, 16)

    def place(self, marker=0, option="0801"):
        """Position in mm."""
        text = self.tx(option)[0][marker][0]
        return np.array([int(text[24 + 7 * i : 31 + 7 * i]) / 100 for i in range(3)])


@pytest.mark.parametrize(("text", "crc"), [
    ("INIT:", "E3A5"), ("OKAY", "A896"), ("RESET", "BE6F"), ("VER:0", "65EE"),
    ("GETINFO:Features.Firmware.Version", "0492"),
])  # fmt: skip
def test_crc_has_the_published_check_values(text, crc):
    """CRC-16 of real exchanges."""
    assert f"{crc16(text.encode()):04X}" == crc


def test_power_up_says_reset_and_wants_init_first():
    """RESETBE6F and CR; before INIT other commands are refused with 10; both forms of a command are understood."""
    host = Host(announce=True)

    assert host.wait(5) == b"RESETBE6F\r"
    assert host.ask("PHSR:00") == "ERROR10"
    assert host.raw(b"INIT:E3A5\r") == b"OKAYA896\r"
    assert host.raw(b"INIT \r") == b"OKAYA896\r"
    assert host.raw(b"PHSR 02\r")[:2] == b"00"


@pytest.mark.parametrize(("sent", "answer"), [
    (b"NONSENSE \r", "ERROR01"),
    (b"PVWR " + b"0" * 300 + b"\r", "ERROR02"),
    (b"INIT:\r", "ERROR03"),
    (b"INIT:E3A6\r", "ERROR04"),
    (command("COMM:90000"), "ERROR06"),
    (command("COMM:5000"), "ERROR07"),
    (command("PHRQ:1"), "ERROR07"),
    (command("PINIT:07"), "ERROR08"),
    (command("PHF:07"), "ERROR08"),
    (command("TX:0801"), "ERROR0C"),
    (command("TSTOP:"), "ERROR0C"),
    (command("PHSR:09"), "ERROR23"),
])  # fmt: skip
def test_errors(sent, answer):
    """Each wrong command has its number, with a CRC as every reply."""
    host = Host()
    host.ask("INIT:")

    assert host.raw(sent) == answer.encode() + f"{crc16(answer.encode()):04X}\r".encode()


def test_a_handle_goes_its_way_in_order():
    """Asked for, loaded, initialised, enabled: PHSR sorts by it; out of order it is refused."""
    host = Host()
    host.ask("INIT:")
    assert host.ask("PHRQ:*********1****") == "01"
    assert host.ask("PINIT:01") == "ERROR0D"
    assert host.ask("PENA:01D") == "ERROR0E"
    assert host.ask("PVWR:0103D0" + "0" * 128) == "ERROR23"
    assert host.ask("PVWR:0103C0" + "0" * 128) == "OKAY"
    assert host.ask("PVWR:010000" + "0" * 126) == "ERROR03"
    assert host.ask("PHSR:02") == "0101001"
    assert host.ask("PINIT:01") == "ERROR13"
    host.load(1)
    assert host.ask("PINIT:01") == "OKAY"
    assert host.ask("PHSR:03") == "0101011"
    assert host.ask("PDIS:01") == "ERROR0F"
    assert host.ask("PENA:01X") == "ERROR09"
    assert host.ask("PENA:01D") == "OKAY"
    assert host.ask("PHSR:04") == "0101031"
    assert host.ask("TSTART:") == "OKAY"
    assert host.ask("PHF:01") == "ERROR0C"
    assert host.ask("TSTOP:") == "OKAY"
    assert host.ask("PHF:01") == "OKAY"
    assert host.ask("PHSR:00") == "00"


def test_tx_has_its_fields_at_their_places():
    """Handle, four times 6, three times 7 and 6 characters, status, frame, LF; then the system status."""
    host = Host().track()
    text = host.ask("TX:0801")

    assert len(text) == 2 + 2 * (PORT_LINE + 0) + 4
    assert text[:4] == "0201"
    line = text[4 : 2 + PORT_LINE]
    assert all(line[i] in "+-" for i in (0, 6, 12, 18, 24, 31, 38, 45))
    assert text.endswith("\n0000")


def test_bx_says_the_same_as_tx():
    """Start word, length, both CRCs, then the numbers of the text reply of the same frame."""
    host = Host().track()
    rows, _ = host.tx()
    reply = host.raw(command("BX:0801"), ms=0.9 + 1.1)
    start, length, head_crc = struct.unpack_from("<HHH", reply)

    assert (start, len(reply)) == (0xA5C4, 6 + length + 2)
    assert head_crc == crc16(reply[:4])
    assert struct.unpack_from("<H", reply, 6 + length)[0] == crc16(reply[6:-2]) == crc16(reply[:-2])
    assert reply[6] == 2
    handle, status, *numbers, port, frame = struct.unpack_from("<BB8fII", reply, 7)
    text = rows[0][0]
    assert (handle, status, port, frame) == (1, 1, rows[0][1], rows[0][2])
    np.testing.assert_allclose(numbers[:4], [int(text[6 * i : 6 * i + 6]) / 1e4 for i in range(4)], atol=6e-5)
    np.testing.assert_allclose(numbers[4:7], [int(text[24 + 7 * i : 31 + 7 * i]) / 100 for i in range(3)], atol=6e-3)


def test_frames_count_at_60_hz_and_the_same_frame_reads_the_same():
    """One second is 60 frames; between two frames nothing changes, noise included."""
    host = Host().track()
    first = host.tx()[0]
    host.wait(998)
    second = host.tx()[0]
    assert second[0][2] - first[0][2] == 60
    again = [host.tx()[0] for _ in range(3)]
    assert len({repr(rows) for rows in again}) <= 2


def test_noise_is_that_of_the_settings():
    """One sigma of 0.07 mm each axis over 600 frames, unbiased, about the true marker."""
    host = Host().track()
    scene = host.device.session.scene
    got = 1e3 * np.array([scene.see(TOOL, k).pose[:3, 3] for k in range(600)])

    np.testing.assert_allclose(got.std(axis=0), 0.07, rtol=0.12)
    np.testing.assert_allclose(got.mean(axis=0), 1e3 * scene._pose(TOOL, 0)[:3, 3], atol=0.012)


def test_a_frame_shows_the_tip_where_it_was_a_latency_ago():
    """The pose of a moving tip lags by latency: frame k carries the pose of its exposure."""
    host = Host(scene={"noise_m": 0.0, "noise_rad": 0.0, "latency_s": 0.05}).track()
    t0 = host.now_ns
    for k in range(500):
        t = t0 + k * 2 * MS
        q = np.zeros(5)
        q[:3] = 0.02 * (t - t0) * 1e-9
        host.world.set_joints(q, [0.02] * 3 + [0, 0], np.zeros(5), t)
    host.now_ns = t0 + 900 * MS
    rows, _ = host.tx()
    scene = host.device.session.scene
    frame = rows[0][2]

    age = host.now_ns - 2 * MS - scene.exposure_ns(frame)
    assert 50 * MS <= age < (50 + 17) * MS
    expected = scene.settings.registration.matrix @ host.world.tip_pose(scene.exposure_ns(frame))
    expected = expected @ scene.settings.tool_marker.matrix
    text = rows[0][0]
    got = [int(text[24 + 7 * i : 31 + 7 * i]) / 100 for i in range(3)]
    np.testing.assert_allclose(got, 1e3 * expected[:3, 3], atol=0.006)
    w_first = quaternion_from_rotation(expected[:3, :3])[3]
    assert int(text[:6]) / 1e4 == pytest.approx(w_first, abs=1e-4)


def test_missing_and_out_of_volume():
    """MISSING is a word; outside of the volume the numbers come only with option 0800, and bit 0x40 in either case."""
    host = Host().track()
    host.world.faults = {"tracker.missing"}
    rows, _ = host.tx()
    assert [rows[0][0], rows[1][0] != "MISSING"] == ["MISSING", True]
    bx = host.raw(command("BX:0801"))
    assert (bx[7], bx[8], bx[17], bx[18]) == (1, 2, 2, 1)
    host.world.faults = {"tracker.outside"}
    assert host.tx("0001")[0][0][0] == "MISSING"
    assert host.tx("0801")[0][0][0] != "MISSING"
    assert host.tx("0001")[0][0][1] & 0xF1 == 0x71
    host.world.faults = {"tracker.partly"}
    assert host.tx("0001")[0][0][1] & 0x80


@pytest.mark.parametrize(("fault", "moves"), [
    ("tracker.moved_reference", (False, True)), ("tracker.moved_marker", (True, False)),
    ("tracker.moved_camera", (True, True)), ("tracker.swapped", (True, True)),
])  # fmt: skip
def test_moved_and_swapped(fault, moves):
    """What is moved shows in the marker concerned and in no other."""
    host = Host(scene={"noise_m": 0.0, "noise_rad": 0.0}).track()
    before = [host.place(i) for i in range(2)]
    host.world.faults = {fault}
    after = [host.place(i) for i in range(2)]

    assert tuple(np.linalg.norm(a - b) > 1.0 for a, b in zip(after, before, strict=True)) == moves
    if fault == "tracker.swapped":
        np.testing.assert_array_equal(after[0], before[1])


def test_dropped_and_repeated_frames():
    """Dropped: every fifth number never comes. Repeated: it comes with the data of the one before."""
    host = Host().track()
    host.world.faults = {"tracker.dropped@5"}
    numbers = set()
    for _ in range(200):
        numbers.add(host.tx()[0][0][2])
        host.wait(3)
    assert not [n for n in numbers if n % 5 == 0]
    assert max(numbers) - min(numbers) + 1 - len(numbers) == pytest.approx(len(numbers) / 4, abs=2)
    host.world.faults = {"tracker.repeated@5"}
    scene = host.device.session.scene
    for k in (10, 15):
        np.testing.assert_array_equal(scene.see(TOOL, k).pose, scene.see(TOOL, k - 1).pose)
    assert not np.array_equal(scene.see(TOOL, 11).pose, scene.see(TOOL, 10).pose)


def test_counter_restart_and_whole_restart():
    """The counter falls back to 0 and tracking goes on; after a whole restart the tracker wants INIT again."""
    host = Host().track()
    host.wait(5000)
    assert host.tx()[0][0][2] > 290
    host.world.faults = {"tracker.frames_restart"}
    host.wait(50)
    assert host.tx()[0][0][2] < 10
    host.world.faults = {"tracker.restart"}
    assert host.wait(5) == b""
    assert host.wait(5) == b"RESETBE6F\r"
    assert host.ask("TX:0801") == "ERROR10"


def test_system_status_bad_crc_and_silence():
    """Status bits by name and by number; a broken CRC on each N-th reply; no reply at all."""
    host = Host().track()
    host.world.faults = {"tracker.interference", "tracker.status.5"}
    assert host.tx()[1] == 0x22
    host.world.faults = {"tracker.bad_crc"}
    reply = host.raw(command("TX:0801"))
    assert f"{crc16(reply[:-5]):04X}".encode() != reply[-5:-1]
    host.world.faults = {"tracker.silent"}
    assert host.raw(command("TX:0801"), 1000) == b""


def test_disabled_handles_are_named_so():
    """A handle that is not enabled is DISABLED in TX and has no data in BX."""
    host = Host()
    host.ask("INIT:")
    host.ask("PHRQ:*********1****")
    host.ask("TSTART:")
    assert host.tx()[0][0][0] == "DISABLED"
    bx = host.raw(command("BX:0801"))
    assert struct.unpack_from("<H", bx, 2) == (5,)
    assert bx[6:9] == b"\x01\x01\x04"


def test_comm_answers_at_the_old_speed_and_a_host_that_does_not_follow_is_garbled():
    """The OKAY leaves at 9600; then 115200 is wanted: a host still at 9600 reads and writes noise."""
    host = Host(paced=True)
    host.device.host_baud_rate = 9600
    host.ask("INIT:", ms=40)
    assert host.device.line.baud_rate == 9600
    reply = host.raw(command("COMM:50000"), ms=40)
    assert reply == b"OKAYA896\r"
    assert (host.device.line.baud_rate, host.device.line.parity, host.device.line.stop_bits) == (115_200, "N", 1)
    assert host.raw(command("INIT:"), 40) == b""
    host.device.host_baud_rate = 115_200
    host.raw(b"\r", 5)
    assert host.ask("INIT:", ms=5) == "OKAY"
    host.wait(3000)
    host.device.host_baud_rate = 9600
    assert host.ask("INIT:", ms=40) == "OKAY"
    assert host.device.line.baud_rate == 9600


def test_replies_take_their_time_on_the_wire():
    """A TX of one tool is 81 characters: 7 ms at 115200, and not there after 5."""
    host = Host(paced=True)
    host.ask("INIT:", ms=50)
    host.ask("COMM:50000", ms=50)
    host.ask("PHRQ:*********1****", ms=30)
    host.load(1)
    for text in ("PINIT:01", "PENA:01D", "TSTART:"):
        host.ask(text, ms=30)
    early = host.raw(command("TX:0801"), ms=5)
    late = host.wait(5)

    assert 0 < len(early) < len(early + late) == 2 + PORT_LINE + 4 + 5


@settings(max_examples=100)
@given(st.lists(st.one_of(st.binary(max_size=30), st.sampled_from([
    command("INIT:"), command("TX:0801"), command("BX:0801"), command("PHRQ:*********1****"), command("PENA:01D"),
    command("TSTART:"), b"TX \r", b"PHINF 01\r", b"PVWR 01\r", b"GETINFO x\r", b"COMM \r", b"VER 9\r", b"\r",
])), max_size=10).map(b"".join), st.data())  # fmt: skip
def test_any_chunking_and_any_garbage(data, draw):
    """Whatever comes, in whatever pieces, is answered the same, and never an exception."""
    whole, pieces = Host(), Host()
    whole.device.feed(data, whole.now_ns)
    rest = data
    while rest:
        cut = draw.draw(st.integers(1, len(rest)))
        pieces.device.feed(rest[:cut], pieces.now_ns)
        rest = rest[cut:]

    assert whole.wait(100) == pieces.wait(100)


def test_garbled_bytes_hold_no_carriage_return():
    """Noise never ends a command by chance."""
    assert 0x0D not in garble(bytes(range(256)))
    assert REFERENCE != TOOL


def test_definitions_are_those_of_the_vectors():
    """752 bytes: signature, sum of what follows the checksum, marker count, spheres in mm, each body's own distances."""
    for name in ("tool", "reference"):
        data = rom(name).read_bytes()
        assert Host().device.files[f"{name}.rom"] == data
        assert (len(data), data[:4]) == (752, b"NDI\0")
        assert struct.unpack_from("<H", data, 4)[0] == sum(data[6:]) % 65536
        spheres = np.array(struct.unpack_from("<12f", data, 72)).reshape(4, 3)
        gaps = np.linalg.norm(spheres[:, None] - spheres, axis=-1)[np.triu_indices(4, 1)]
        assert data[28] == 4
        assert np.diff(np.sort(gaps)).min() > 1.0
