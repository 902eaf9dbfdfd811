"""An ATI NETCANOEM sensor in a log of its bus: the codec's frames and the sampler's pairs, with nobody asking."""

from collections import Counter
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from galen_hw.drivers.ati_netcanoem import codec
from galen_hw.drivers.ati_netcanoem.codec import REPLY_LENGTHS, SATURATED_COUNTS, Op
from galen_hw.drivers.ati_netcanoem.start import AtiSettings, fence, new_sampler
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.listening import Frames, Heard, matrix_of
from galen_hw.errors import UsageError
from galen_hw.units import FORCE_TO_NEWTON, TORQUE_TO_NEWTON_METRE

KEYS: Final = ("base_id", "matrix", "serial_number")
ROWS: Final = 6


def recognises(frames: Frames, settings: dict[str, Any]) -> int:
    """How many samples of such a sensor a log may hold."""
    base = _base_id(frames, settings)
    return 0 if base is None else sum(_is(frame, base, 1) for frame, _ in frames)


def listen(frames: Frames, settings: dict[str, Any]) -> Heard:
    """The samples.

    Args:
        frames: of the log, in order.
        settings: base_id, else the one that is heard; matrix: (6, 6) from gauges 0 to 5 in counts to N and N m, else the one
            that the log holds.

    Raises:
        UsageError: no calibration matrix is known, or it is none.
    """
    base = _base_id(frames, settings)
    if base is None:
        raise UsageError("no sample of an ATI NETCANOEM board is in it", todo="is its base id right?")
    matrix, described = _calibration(frames, base, settings)
    pairs, lost = _pairs(frames, base)
    # Status, gauges 0 2 4, then 1 3 5.
    counts = np.array([codec.decode_sample(first, second)[1] for first, second, _ in pairs], dtype=float).reshape(-1, 6)
    words = np.array([codec.decode_sample(first, second)[0] for first, second, _ in pairs], dtype=np.int64)
    wrench = counts @ matrix.T
    saturated = (np.abs(counts) >= SATURATED_COUNTS).any(axis=1)
    faulty = (words & codec.CRITICAL_MASK) != 0
    wrench[saturated | faulty] = np.nan
    lost |= {
        "a gauge at its limit (left empty)": int(saturated.sum()),
        "the board reports an error (left empty)": int(faulty.sum()),
    }
    t_ns = np.array([t for *_, t in pairs], dtype=np.int64)
    serial = _last(frames, base, Op.SERIAL_NUMBER)
    return Heard(t_ns, wrench, codec.decode_serial_number(serial) if serial else "", described, lost)


def _is(frame: CanFrame, base: int, opcode: int) -> bool:
    return frame.arbitration_id == base << 4 | opcode and len(frame.data) == REPLY_LENGTHS[opcode]


def _base_id(frames: Frames, settings: dict[str, Any]) -> int | None:
    """The base id given, or the one of most second halves that follow their first."""
    if isinstance(settings.get("base_id"), int):
        return int(settings["base_id"])
    seen: Counter[int] = Counter()
    before: dict[int, bool] = {}
    for frame, _ in frames:
        base, opcode = divmod(frame.arbitration_id, 16)
        if opcode == 0 and len(frame.data) == REPLY_LENGTHS[0]:
            before[base] = True
        elif opcode == 1 and len(frame.data) == REPLY_LENGTHS[1] and before.pop(base, False):
            seen[base] += 1
    return seen.most_common(1)[0][0] if seen else None


def _pairs(frames: Frames, base: int) -> tuple[list[tuple[bytes, bytes, int]], dict[str, int]]:
    """Pairs that answer one request, by the sampler; where the log has no requests, by the first frame of each."""
    settings = AtiSettings(base_id=base)
    counters = dict.fromkeys(codec.COUNTERS, 0)
    sampler = new_sampler(settings, fence(settings), {}, counters)
    sampler.verify_repeats = False  # who asked was seen, or could not be
    asked = any(frame.arbitration_id == base << 4 and not frame.data for frame, _ in frames)
    pairs, firsts = [], 0
    for frame, t_ns in frames:
        opcode = frame.arbitration_id - (base << 4)
        if opcode == 0 and (not frame.data if asked else len(frame.data) == codec.FIRST.size):
            sampler.start(t_ns)
            sampler.poll(t_ns)
        if opcode not in (0, 1) or not frame.data:
            continue
        firsts += opcode == 0
        pair = sampler.feed(opcode, frame.data, t_ns)
        if pair is not None:
            pairs.append(pair)
    return pairs, {"a sample of which one frame is missing": max(0, firsts - len(pairs))}


def _last(frames: Frames, base: int, opcode: int) -> bytes:
    return next((f.data for f, _ in reversed(frames) if _is(f, base, opcode)), b"")


def _calibration(frames: Frames, base: int, settings: dict[str, Any]) -> tuple[npt.NDArray[np.float64], str]:
    if "matrix" in settings:
        given = matrix_of(settings["matrix"], ROWS)
        if given is None:
            raise UsageError("not 6 x 6 numbers", where="can.matrix", todo="gauges 0 to 5 in counts to N and N m")
        return given, "calibration matrix of the map"
    rows = _rows(frames, base)
    if rows is None:
        what = "the log holds no calibration matrix of the sensor"
        todo = "log from before the daemon starts, or give can.matrix (6 x 6, counts to N and N m) in a map"
        raise UsageError(what, todo=todo)
    counts, units = (codec.DEFAULT_COUNTS_PER_UNIT,) * 2, ("N", "N-m")
    if data := _last(frames, base, Op.COUNTS_PER_UNIT):
        counts = codec.decode_counts_per_unit(data)
    if data := _last(frames, base, Op.UNIT_CODES):
        try:
            units = codec.decode_unit_codes(data)
        except KeyError as unknown:
            raise UsageError(f"unknown unit code {unknown}", todo="give can.matrix in a map") from None
    to_si = FORCE_TO_NEWTON[units[0]], TORQUE_TO_NEWTON_METRE[units[1]]
    said = f"calibration matrix from the log, {counts[0]} counts/{units[0]}, {counts[1]} counts/{units[1]}"
    return codec.si_matrix(rows, counts, to_si), said


def _rows(frames: Frames, base: int) -> npt.NDArray[np.float64] | None:
    """The six rows, each as it was answered last: by the axis that was asked for, else by their order."""
    found: dict[int, tuple[float, ...]] = {}
    axis, parts, following = -1, b"", 0
    for frame, _ in frames:
        opcode = frame.arbitration_id - (base << 4)
        if opcode == Op.MATRIX_ROW and len(frame.data) == 1:
            axis, parts = frame.data[0], b""
        elif opcode == Op.MATRIX_ROW and len(frame.data) == 8:
            parts = frame.data
        elif opcode in (Op.MATRIX_SECOND, Op.MATRIX_THIRD) and len(frame.data) == 8 and len(parts) == 8 * (opcode - 2):
            parts += frame.data
            if len(parts) == 24:
                found[axis if axis >= 0 else following % ROWS] = codec.decode_matrix_row(parts)
                following, axis, parts = following + 1, -1, b""
    if set(found) != set(range(ROWS)):
        return None
    rows = np.array([found[i] for i in range(ROWS)])
    return rows if np.isfinite(rows).all() and np.linalg.matrix_rank(rows) == ROWS else None
