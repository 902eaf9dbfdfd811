"""The virtual controller's command language, as the manuals and real drivers state it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.drivers.virtual.galil_dmc import VirtualGalilDmc
from galen_hw.drivers.virtual.world import World
from tests.galil_host import Host

DIALOGUES = [
    ("TP", "0, 0, 0, 0, 0\r\n:"),
    ("", ":"),
    ("SH", ":"),
    ("SH;MO;SH", ":::"),
    ("TPA;XX;TPB", "0\r\n:?0\r\n:"),
    ("tp", "?"),
    ("PA 1,,3;PA ?,?,?", ":1, 0, 3\r\n:"),
    ("PAB=-7;PAB=?", ":-7\r\n:"),
    ("PRX=5;PR?", ":5\r\n:"),
    ("SP 1001;SP?", ":1000\r\n:"),
    ("AC 5000;AC ?", ":4096\r\n:"),
    ("AC 100;TC1", "?6 Number out of range\r\n:"),
    ("LD 3,,1;LD ?,?,?", ":3, 0, 1\r\n:"),
    ("SP*=2000;SP?,?,?,?,?", ":2000, 2000, 2000, 2000, 2000\r\n:"),
    ("MG _BGA,_BGB", " 0.0000 0.0000\r\n:"),
    ('MG "HX=",_HX0,_HX1', "HX= 0.0000 0.0000\r\n:"),
    ("MG -1,_MOA", "-1.0000 1.0000\r\n:"),
    ("MG _AB;MG @IN[7]", " 1.0000\r\n: 1.0000\r\n:"),
    ("QZ", "5, 52, 26, 36\r\n:"),
    ("XX;TC1;TC", "?1 Unrecognized command\r\n:0\r\n:"),
    ("XX;TC0;TC0", "?1\r\n:0\r\n:"),
    ("XX;MG _TC;TC", "? 1.0000\r\n:1\r\n:"),
    ("BGA;TC1", "?20 Begin not valid with motor off\r\n:"),
    ("BGH;TC", "?4\r\n:"),
    ("homed=3;MG homed;homed=", ": 3.0000\r\n: 3.0000\r\n:"),
    ("ZA 5,6;MG _ZAB", ": 6.0000\r\n:"),
    ("EO?;LZ?;PF?;VF?;CW?", "0\r\n:1\r\n:10.0\r\n:10.4\r\n:2\r\n:"),
    ("DP 21,-9;TPA;TPB", ":21\r\n:-9\r\n:"),
    ("DP 21,-9;LZ 0;TP AB", ":: 0000000021,-0000000009\r\n:"),
    ("DP 12345,-12345;PF 3.0;TP AB", "::999, -999\r\n:"),
    ("DP 12345;VF 3.1;MG _TPA", ":: 999.9\r\n:"),
    ("CN ?,?;CN 1;CN?", "-1, -1\r\n::1\r\n:"),
    ("TSA", "46\r\n:"),
    ("SC", "1, 1, 1, 1, 1\r\n:"),
    ("OE 1,1;ER 500;ER ?,?", "::500, 16384\r\n:"),
    ("WT 10;TC", "?2\r\n:"),
]


@pytest.mark.parametrize(("line", "answer"), DIALOGUES)
def test_answers_like_the_data_sheet(line, answer):
    """Each command of a line gets its own colon or question mark, data before it."""
    assert Host().ask(line) == answer


def test_revision_by_control_characters():
    """^R^V tells the model, without a carriage return."""
    host = Host()
    host.device.feed(b"\x12\x16", 0)

    assert host.wait(1) == b"DMC4153 Rev 1.3a\r\n:"


def test_a_line_may_have_80_characters_and_no_more():
    """80 characters pass; the 81st is refused at once with code 5 and the rest is swallowed."""
    host = Host()
    line = "MG " + "1" * 8 + ",1" * 34 + "1"

    assert len(line) == 80
    assert host.ask(line).endswith("\r\n:")
    assert host.ask(line + "2" * 40) == "?"
    assert host.ask("TC1") == "5 Input buffer full\r\n:"


def test_echo_is_on_at_power_up_and_sends_back_every_byte():
    """The first line comes back, EO 0 included; then only answers."""
    host = Host({"baud_rate": 0})

    assert host.ask("EO 0") == "EO 0\r:"
    assert host.ask("TPA") == "0\r\n:"


def test_download_is_silent_and_acknowledged_twice():
    """DL answers nothing until the backslash, then two colons; a long line gets its question mark before them."""
    host = Host()

    assert host.ask("DL") == ""
    assert host.ask("#A") == ""
    assert host.ask('MG "' + "x" * 90 + '"') == "?"
    assert host.ask("EN") == ""
    assert host.ask("\\") == "::"
    assert host.ask("LS") == "0 #A\r\n1 EN\r\n:"


def test_programs_speak_unsolicited_with_the_highest_bit_on_demand():
    """CW 1 marks every byte of a program's message; CF with a handle sends it elsewhere."""
    host = Host()
    for line in ("DL", "#A", 'MG "HELLO"', "WT 20", 'MG "AGAIN"', "EN", "\\"):
        host.ask(line)
    marked = bytes(b | 0x80 for b in b"HELLO\r\n")

    assert host.ask("CW 1") == ":"
    assert host.ask_raw("XQ #A", 10) == b":" + marked
    assert host.wait(30) == bytes(b | 0x80 for b in b"AGAIN\r\n")
    assert host.ask("CW 2;XQ #A,1", 50) == "::HELLO\r\nAGAIN\r\n"
    assert host.ask("CF A;XQ #A", 50) == "::"
    assert host.ask("XQ #B;TC1") == "?10 Empty program line or undefined label\r\n:"


def test_a_program_that_goes_wrong_says_where():
    """A rejected command ends the thread with an unsolicited line and leaves its code for TC."""
    host = Host()
    for line in ("DL", "#A", "BGA", "EN", "\\"):
        host.ask(line)

    assert host.ask("XQ #A", 10) == ":?1 BGA\r\n"
    assert host.ask("TC;MG _XQ0") == "20\r\n:-1.0000\r\n:"


def test_reset_returns_to_power_up_or_to_what_was_burned():
    """RS forgets what was not burned, drops power, and is deaf meanwhile."""
    host = Host()
    host.ask("SH;LZ 0;SP 4000;x=1")

    assert host.ask("RS") == ""
    assert host.ask("TP") == ""
    assert host.wait(400) == b":"
    assert host.ask("LZ?;SP?;MG _MOA;x=") == "1\r\n:25000\r\n: 1.0000\r\n:?"
    host.ask("LZ 0;BN;RS")
    host.wait(400)
    assert host.ask("LZ?") == "0\r\n:"


ALPHABET = st.one_of(
    st.sampled_from([c.encode("latin-1") + b"\r" for c, _ in DIALOGUES]),
    st.binary(max_size=40),
    st.text('ABCDEPTSGHMRQZLXDOW0123456789,;=?-._ @[]"\r#\\', max_size=30).map(lambda s: s.encode("ascii")),
)


@settings(max_examples=150)
@given(st.lists(ALPHABET, max_size=8).map(b"".join), st.data())
def test_any_chunking_and_any_garbage(data, draw):
    """Whatever comes, in whatever pieces, is answered the same, and never an exception."""
    whole = VirtualGalilDmc(VirtualGalilDmc.Settings(), World())
    pieces = VirtualGalilDmc(VirtualGalilDmc.Settings(), World())
    whole.poll(0)
    pieces.poll(0)
    whole.feed(data, 0)
    rest = data
    while rest:
        cut = draw.draw(st.integers(1, len(rest)))
        pieces.feed(rest[:cut], 0)
        rest = rest[cut:]

    assert b"".join(whole.poll(10**9)) == b"".join(pieces.poll(10**9))
