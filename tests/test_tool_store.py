"""Tools' files: impossible ones are refused in one line, generations are kept, and no power cut leaves half a file."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.config.tool_file import BiasBody, BodyStd, Origin, Term, ToolFile, parse_tool
from galen_hw.config.tool_store import ToolStore, binding_problems, check_binding
from galen_hw.errors import UsageError


def tool(mass=0.287, name="retractor", serial="FT1", virtual=False, **more):
    date = "2026-01-02T03:04:05+00:00"
    bound = {"robot": "galen", "sensor_serial": serial, "virtual": virtual}
    origin = Origin(date=date, software="galen-hw 0", method="robust", **bound)
    std = BodyStd(mass=1e-4, com=(1e-5, 1e-5, 2e-5))
    data = {"name": name, "tip": (0.045, 0.0, -0.14), "mass": mass, "com": (0.031, 0.004, -0.063), "std": std}
    return ToolFile(**(data | {"origin": origin} | more))


@pytest.fixture
def store(tmp_path):
    return ToolStore(tmp_path)


def test_the_nominal_tools_have_geometry_and_no_mass(store):
    """Pointer and retractor come with a tip alone: they were never calibrated."""
    assert store.names() == ["pointer", "retractor"]
    for name in store.names():
        found = store.load(name)
        assert not found.calibrated
        assert (found.mass, found.com, found.origin) == (None, None, None)
        assert found.contact_point == found.tip != (0.0, 0.0, 0.0)


def test_each_save_is_a_generation_and_the_last_is_in_use(store):
    """Numbers count up, the identity bears number and content, older ones stay as they were."""
    saved = [store.save(tool(mass)) for mass in (0.28, 0.29, 0.30)]
    first = store.path("retractor", 1).read_bytes()
    store.save(tool(0.31))

    assert [t.origin.generation for t in saved] == [1, 2, 3]
    assert len({t.calibration_id for t in saved}) == 3
    assert store.load("retractor").mass == 0.31
    assert store.path("retractor", 1).read_bytes() == first
    assert [(g.number, g.active) for g in store.history("retractor")] == [(1, False), (2, False), (3, False), (4, True)]


def test_rollback_goes_back_one_or_to_any(store):
    """Without a number to the one before, with a number anywhere; before the first there is nothing."""
    for mass in (0.28, 0.29, 0.30):
        store.save(tool(mass))

    assert store.rollback("retractor").mass == 0.29
    assert store.rollback("retractor").mass == 0.28
    with pytest.raises(UsageError, match="no earlier calibration"):
        store.rollback("retractor")
    assert store.rollback("retractor", 3).mass == store.load("retractor").mass == 0.30
    with pytest.raises(UsageError, match="no generation 9; there are: 1, 2, 3"):
        store.rollback("retractor", 9)


def test_a_generation_that_is_not_activated_changes_nothing(store):
    """Nothing is in use until it is accepted."""
    store.save(tool(0.28))
    store.save(tool(0.29), activate=False)

    assert store.load("retractor").mass == 0.28


def test_the_selected_tool_is_remembered(store):
    """Over instances; none at first, and none again."""
    assert store.selected() is None
    store.select("pointer")
    assert ToolStore(store.state_dir).selected() == "pointer"
    store.select(None)
    assert store.selected() is None
    with pytest.raises(UsageError, match=r"no tool 'hammer'.*one of: pointer, retractor"):
        store.select("hammer")


def test_a_file_reads_back_as_it_was(store):
    """Every field, terms and covariance included."""
    full = tool(
        parameters=("mass", "com.x"),
        covariance=((1e-8, 1e-10), (1e-10, 1e-10)),
        bias=(0.1, -0.2, 0.3, 0.01, 0.02, 0.03),
        bias_body=BiasBody(mass=0.085, com=(0.002, -0.001, 0.011)),
        zeroed_at={"roll": 0.0, "tilt": 0.0},
        terms=(Term(effect="spring", parameters={"stiffness": 40.0, "anchor": (0.1, 0.2, 0.3)}, source="run 7"),),
        noise_floor=(0.015,) * 6,
    )
    saved = store.save(full)

    assert store.load("retractor") == saved
    assert parse_tool(saved.to_json(), "x") == saved


BASE = json.loads(tool().to_json())
IMPOSSIBLE = {
    "negative mass": ({"mass": -0.1}, "a mass of -0.1 kg is impossible"),
    "grams": ({"mass": 287.0}, "is it in grams"),
    "no mass at all": ({"mass": 0}, "a mass of 0 kg is impossible"),
    "com metres away": ({"com": [3.1, 0.0, 0.0]}, "lies 3.1 m from the sensor: is it in mm"),
    "com in mm": ({"com": [31.0, 4.0, -63.0]}, "is it in mm"),
    "tip in mm": ({"tip": [45.0, 0.0, -140.0]}, "is it in mm"),
    "com of two numbers": ({"com": [0.1, 0.2]}, "com"),
    "NaN": ({"mass": "NaN"}, "mass"),
    "other schema": ({"schema": 2}, "schema 2, this version reads 1"),
    "no schema": ({"schema": None}, "schema None"),
    "unknown key": ({"wieght": 1.0}, "wieght: not a known key"),
    "bias in counts": ({"bias": [12345.0, 0, 0, 0, 0, 0]}, "is it in counts"),
    "negative uncertainty": ({"std": {"mass": -1, "com": [0, 0, 0]}}, "std.mass"),
    "gravity in g": ({"gravity": [0, 0, -1.0]}, "gravity has the size 1"),
    "covariance of the wrong size": ({"parameters": ["mass"], "covariance": []}, "not 1 x 1"),
    "covariance that is none": ({"parameters": ["mass"], "covariance": [[-1.0]]}, "symmetric and positive"),
    "mass without com": ({"com": None}, "mass and com come together"),
    "mass from nowhere": ({"origin": None}, "where it came from"),
    "name with a path": ({"name": "../../etc/passwd"}, "name"),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_an_impossible_file_is_refused_in_one_line(case):
    """File, key, what is wrong and what to do, in a single line."""
    change, text = IMPOSSIBLE[case]
    with pytest.raises(UsageError) as error:
        parse_tool(json.dumps(BASE | change), "tools/retractor/0001.json")

    assert text in str(error.value)
    assert str(error.value).startswith("tools/retractor/0001.json")
    assert "\n" not in str(error.value)


@settings(max_examples=200)
@given(
    st.text() | st.recursive(st.none() | st.floats() | st.text(), lambda x: st.lists(x) | st.dictionaries(st.text(), x))
)
def test_any_text_is_a_tool_or_one_line(content):
    """Whatever a file holds, reading it gives a tool or a UsageError of one line."""
    text = content if isinstance(content, str) else json.dumps(content)
    with pytest.raises(UsageError) as error:
        parse_tool(text, "file")

    assert "\n" not in str(error.value)


def test_a_damaged_generation_is_listed_and_can_be_rolled_back_from(store):
    """A file that the disk has eaten is named with its reason; the older ones still work."""
    store.save(tool(0.28))
    store.save(tool(0.29))
    store.path("retractor", 2).write_text('{"schema": 1, "na', encoding="utf-8")

    with pytest.raises(UsageError, match=r"0002\.json, line 1: not JSON"):
        store.load("retractor")
    assert "not JSON" in store.history("retractor")[1].error
    assert store.rollback("retractor").mass == 0.28


def test_virtual_and_real_calibrations_have_a_pointer_each(store):
    """What is tried on a virtual robot neither replaces the real calibration nor is rolled back to, and says so."""
    real, virtual = (ToolStore(store.state_dir, virtual=kind) for kind in (False, True))
    for mass, kind in ((0.28, False), (0.29, False), (0.40, True)):
        store.save(tool(mass, virtual=kind))

    assert (real.load("retractor").mass, virtual.load("retractor").mass, store.load("retractor").mass) == (
        0.29,
        0.4,
        0.29,
    )
    assert [(g.number, g.active) for g in real.history("retractor")] == [(1, False), (2, True), (3, True)]
    assert real.rollback("retractor").mass == 0.28
    with pytest.raises(UsageError, match="no earlier calibration"):
        virtual.rollback("retractor")
    assert virtual.load("retractor").mass == 0.4
    virtual.select("retractor")
    assert (virtual.selected(), real.selected()) == ("retractor", None)


def test_people_see_the_virtual_calibration_where_there_is_no_real_one(store):
    """Without a daemon: the real one comes first, then the virtual one, then the geometry."""
    store.save(tool(0.4, virtual=True))
    assert store.load("retractor").mass == 0.4
    assert not ToolStore(store.state_dir, virtual=False).load("retractor").calibrated
    store.save(tool(0.28))
    assert store.load("retractor").mass == 0.28


def test_a_calibration_is_bound_to_its_sensor_and_robot(store):
    """Another serial number or robot is named; an unknown one is let pass."""
    found = store.save(tool())

    assert binding_problems(found, sensor_serial="FT1", robot="galen") == []
    assert binding_problems(found, sensor_serial="", robot="") == []
    with pytest.raises(UsageError, match=r"calibrated on sensor FT1, this is FT2.*calibrate --tool retractor"):
        check_binding(found, sensor_serial="FT2", robot="galen")
    assert "robot 'galen', this is 'kuka'" in binding_problems(found, sensor_serial="FT1", robot="kuka")[0]
    for virtual in (True, False):
        other = tool(virtual=not virtual)
        assert binding_problems(other, sensor_serial="FT1", robot="galen", virtual=not virtual) == []
        assert (
            "a virtual robot" in binding_problems(other, sensor_serial="FT1", robot="galen", virtual=virtual)[0]
            or virtual
        )
        assert len(binding_problems(other, sensor_serial="FT1", robot="galen", virtual=virtual)) == 1


CUT = """
import os, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from test_tool_store import tool
from galen_hw.config.tool_store import ToolStore

def save_until(state, last):
    steps = 0
    def cut(event, args):
        nonlocal steps
        if event in ("open", "os.rename", "os.mkdir", "os.remove") and state in str(args[0]):
            steps += 1
            if steps > last:
                os._exit(9)
    sys.addaudithook(cut)
    store = ToolStore(Path(state))
    store.save(tool(0.29))
    store.select("retractor")
    os._exit(0)

for last in range(40):
    state = os.path.join({folder!r}, str(last))
    ToolStore(Path(state)).save(tool(0.28))
    child = os.fork()
    if child == 0:
        save_until(state, last)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    print(last, status, flush=True)
    if status == 0:
        break
"""


def test_no_power_cut_leaves_an_invalid_file(tmp_path):
    """The process dies before each of its file operations in turn: the store always reads, the old or the new tool."""
    code = CUT.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)

    seen = set()
    for last, status in (map(int, line.split()) for line in done.stdout.splitlines()):
        store = ToolStore(tmp_path / str(last))
        found = store.load("retractor").mass
        assert found in (0.28, 0.29)
        assert all(not g.error for g in store.history("retractor"))
        assert store.selected() in (None, "retractor")
        seen.add((status, found))
    assert {(9, 0.28), (9, 0.29), (0, 0.29)} <= seen


def test_a_directory_that_cannot_be_written_is_one_line(tmp_path):
    """A file stands where the directory should be: named, nothing written."""
    (tmp_path / "tools").write_text("in the way")
    with pytest.raises(UsageError, match="cannot be written"):
        ToolStore(tmp_path).save(tool())


def test_a_tool_without_calibration_is_not_saved(store):
    """Geometry alone is no generation."""
    with pytest.raises(UsageError, match="no calibration to save"):
        store.save(store.nominal("pointer"))


def flips(content: bytes, every: int = 1):
    """The content with one bit turned round, for each (or every so many) of its bits."""
    for bit in range(0, 8 * len(content), every):
        yield bit, content[: bit // 8] + bytes([content[bit // 8] ^ (1 << bit % 8)]) + content[bit // 8 + 1 :]


def test_no_flipped_bit_of_a_generation_is_taken_for_another_tool(store):
    """Every bit of the file in use: the same tool (the case of an `e`, a space), or one typed line."""
    saved = store.save(tool(0.93, bias=(0.1, -0.2, 0.3, 0.01, 0.02, 0.03)))
    path = store.path("retractor", 1)
    refused = []
    whole = path.read_bytes()
    for bit, content in flips(whole):
        path.write_bytes(content)
        try:
            assert store.load("retractor") == saved, bit
        except UsageError as error:
            refused.append(str(error))
    assert len(refused) > 0.99 * 8 * len(whole)
    assert not any("\n" in line for line in refused)
    path.write_bytes(whole)
    assert store.load("retractor") == saved


def test_no_flipped_bit_of_a_pointer_is_taken_for_another_choice(store):
    """Of 8 generations and tools of neighbouring names, the one in use or a typed line."""
    for number in range(8):
        store.save(tool(0.21 + 0.01 * number))
        store.save(tool(0.3, name=f"hook{number}"))
    store.activate("retractor", 4)
    store.select("hook4")
    cases = (
        (store.path("retractor", 1).with_name("active.json"), lambda: store.active("retractor"), 4),
        (store.path("retractor", 1).parent.with_name("selected.json"), store.selected, "hook4"),
    )
    refused = []
    for path, read, value in cases:
        whole = path.read_bytes()
        for bit, content in flips(whole):
            path.write_bytes(content)
            try:
                assert read() == value, bit
            except UsageError as error:
                refused.append(str(error))
        path.write_bytes(whole)
        assert read() == value
    assert refused
    assert all("is damaged" in line for line in refused)


def test_files_of_the_version_before_are_taken_and_sealed_once(store, caplog):
    """A generation and pointers without a digest: served, said once, and safe from then on."""
    saved = store.save(tool(0.28))
    path = store.path("retractor", 1)
    path.write_text(saved.to_json() + "\n", encoding="utf-8")
    path.with_name("active.json").write_text('{"generation": 1}\n', encoding="utf-8")

    assert store.load("retractor") == saved
    (record,) = caplog.records
    assert "had no digest" in record.getMessage()
    assert '"digest": "sha256:' in path.read_text(encoding="utf-8")
    assert store.load("retractor") == saved
    assert len(caplog.records) == 1
    path.write_text(path.read_text(encoding="utf-8").replace("0.28", "0.29"), encoding="utf-8")
    with pytest.raises(UsageError, match="is not what was written: its digest is another"):
        store.load("retractor")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"schema": ' + "1" * 5000 + "}", '{"generation": ' + "9" * 5000 + "}"]
)
def test_nesting_and_huge_numbers_are_one_line(store, text):
    """In a generation, in the pointer to it, and in the tool that is selected."""
    store.save(tool(0.28))
    store.select("retractor")
    path = store.path("retractor", 1)
    for damaged, read in (
        (path, lambda: store.load("retractor")),
        (path.with_name("active.json"), lambda: store.load("retractor")),
        (path.parent.with_name("selected.json"), store.selected),
    ):
        whole = damaged.read_bytes()
        damaged.write_text(text, encoding="utf-8")
        with pytest.raises(UsageError) as error:
            read()
        assert "\n" not in str(error.value)
        damaged.write_bytes(whole)
