"""What a logger of one's own writes: other words, other programs' ways of saving, columns that are missing; what is said."""

import gzip
import io
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from galen_hw.cli import main
from galen_hw.errors import UsageError
from galen_hw.formats import read
from galen_hw.formats.names import plain
from galen_hw.recording.observations import observations_of
from tests.urdf_parts import arm_with_gripper

T = (np.arange(60) * 0.1).round(6)
Q = 0.8 * np.sin(np.outer(T, [0.7, 1.1]) + np.array([0.0, 1.0]))
NAMES = ("time", "q1", "q2", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


def logged(names: tuple[str, ...] = NAMES) -> pd.DataFrame:
    """Two joints and a wrench of nought point something, with names of one's own."""
    wrench = np.random.default_rng(2).normal(size=(len(T), 6))
    return pd.DataFrame(np.c_[T, Q, wrench].round(6), columns=list(names))


def written(folder: Path, data: pd.DataFrame | bytes, name: str = "log.csv", *, robot: bool = True) -> Path:
    """The file, with the robot's URDF beside it."""
    if robot:
        (folder / "arm.urdf").write_text(arm_with_gripper(beside=False))
    content = data if isinstance(data, bytes) else data.to_csv(index=False).encode()
    (folder / name).write_bytes(content)
    return folder / name


@pytest.mark.parametrize(
    "names",
    [
        ("Zeit", "Gelenk1", "Gelenk2", "Kraft_x", "Kraft_y", "Kraft_z", "Moment_x", "Moment_y", "Moment_z"),
        ("Zeit (s)", "Winkel_1", "Winkel_2", "KraftX", "KraftY", "KraftZ", "DrehmomentX", "DrehmomentY", "DrehmomentZ"),
        ("temps", "articulation_1", "articulation_2", *(f"{w}_{a}" for w in ("force", "couple") for a in "xyz")),
        ("tiempo", "articulación 1", "articulación 2", *(f"{w} {a}" for w in ("Fuerza", "Par") for a in "XYZ")),
        ("tempo", "giunto_1", "giunto_2", *(f"{w}_{a}" for w in ("forza", "coppia") for a in "xyz")),
    ],
    ids=["German", "German, composed", "French", "Spanish", "Italian"],
)
def test_words_of_other_languages(names: tuple[str, ...], tmp_path: Path) -> None:
    """The same columns as by English words, and the clock is one."""
    found = read(written(tmp_path, logged(names)))
    assert found.info.predict == "wrench"
    np.testing.assert_array_equal(found.columns["time"], T)
    np.testing.assert_array_equal(found.columns["joint.elbow.position"], Q[:, 1].round(6))
    assert found.has("wrench")
    assert not [name for name in found.columns if name.startswith("covariate.")]


@pytest.mark.parametrize("name", ["compare_x", "parameter_1", "temporary", "axes", "moments_lost", "partial_x"])
def test_words_that_only_begin_so_stay(name: str) -> None:
    """A word is one as a whole."""
    assert plain(name) == name


def test_a_table_that_excel_saves_as_unicode_text(tmp_path: Path) -> None:
    """UTF-16 with tabs; its reader knew it, and no format was told by it."""
    path = written(tmp_path, logged().to_csv(index=False, sep="\t").encode("utf-16"))
    assert read(path).info.predict == "wrench"


def workbook() -> bytes:
    """The beginning of an .xlsx."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as packed:
        packed.writestr("[Content_Types].xml", "<Types/>")
        packed.writestr("xl/workbook.xml", "<workbook/>")
    return made.getvalue()


def packed() -> bytes:
    """A zip of something else."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as out:
        out.writestr("log.csv", "1,2")
    return made.getvalue()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (workbook(), "an Excel workbook; save the sheet as CSV"),
        (packed(), "a packed file; unpack it"),
        (gzip.compress(b"t,q1\n0,1\n"), "a packed file; unpack it: gunzip"),
    ],
    ids=["xlsx", "zip", "gz"],
)
def test_what_is_not_read_is_called_by_its_name(data: bytes, said: str, tmp_path: Path) -> None:
    """Not a list of twelve formats that it is none of."""
    with pytest.raises(UsageError, match=said):
        read(written(tmp_path, data))


@pytest.mark.parametrize(
    ("without", "robot", "said"),
    [
        (["q1", "q2"], True, "a wrench alone: how the sensor stood is not known; record the joints"),
        ([], False, "the joints of which robot\\?; --robot FILE.urdf"),
        (
            [n for n in NAMES if n[0] in "FT"],
            True,
            "no wrench, effort or pose to compare; say which is which: galen-hw import ",
        ),
    ],
    ids=["no joints", "no robot", "joints alone"],
)
def test_what_is_missing_for_a_comparison_is_named(without: list[str], robot: bool, said: str, tmp_path: Path) -> None:
    """It had been "nothing is named to compare", which helps nobody who has only a CSV."""
    recording = read(written(tmp_path, logged().drop(columns=without), robot=robot))
    with pytest.raises(UsageError, match=said):
        observations_of(recording)


def test_columns_with_names_of_ones_own_are_given_by_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is said leads there: a map, edited, beside the file, and the same command again."""
    own = tuple(f"ft_{i}" for i in range(6))
    path = written(tmp_path, logged((*NAMES[:3], *own)))
    assert main(["check", str(path)]) == 2
    said = capsys.readouterr().err
    assert "ft_0, ft_1, ft_2, ft_3, ft_4, ft_5 are no names that are known" in said
    todo = said.partition("galen-hw import ")[2].partition(",")[0].split()
    assert main(["import", *todo]) == 0
    made = Path(todo[-1])
    text = made.read_text()
    for i, name in enumerate(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"):
        text = text.replace(f'"covariate.ft_{i}"', f'"{name}"')
    made.write_text(text)
    assert read(path).info.predict == "wrench"


def test_a_joint_that_was_not_logged_is_missed_by_check_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`check` had called good what `diagnose` refuses."""
    path = written(tmp_path, logged().drop(columns="q2"))
    assert main(["check", str(path)]) == 1
    assert "1 of the robot's joints have no position, first elbow" in capsys.readouterr().out


def test_the_sensors_link_is_named_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The URDF of a UR ends in three links; a recording of one's own has no recording.json to name one in."""
    path = written(tmp_path, logged())
    (tmp_path / "arm.urdf").write_text(arm_with_gripper())
    assert main(["check", str(path)]) == 1
    assert "(--sensor-link, or sensor_link in recording.json)" in capsys.readouterr().out
    assert main(["check", str(path), "--sensor-link", "sensor"]) == 0
    assert main(["check", str(path), "--sensor-link", "sensr"]) == 2
    assert "no link 'sensr'" in capsys.readouterr().err
    assert main(["import", str(path), "-o", str(tmp_path / "run"), "--robot", str(tmp_path / "arm.urdf")]) == 0
    assert main(["check", str(tmp_path / "run"), "--sensor-link", "sensor"]) == 0
    assert main(["check", "--sensor-link", "sensor"]) == 2
