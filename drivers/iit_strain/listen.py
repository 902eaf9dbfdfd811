"""Read an IIT sensor's samples from a log of its bus: the codec's vectors and the pairer's pairs, with nobody asking."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.iit_strain import codec
from galen_hw.drivers.iit_strain.codec import ANSWER_LENGTHS, Command, Stream
from galen_hw.drivers.listening import Frames, Heard, is_first, most_heard, paired
from galen_hw.drivers.paired_sensor import AXES
from galen_hw.errors import UsageError

KEYS: Final = ("address", "full_scales")


def recognises(frames: Frames, settings: dict[str, Any]) -> int:
    """Count the samples of such a sensor that a log may hold."""
    address = _address(frames, settings)
    return 0 if address is None else sum(is_first(frame, codec.layout(address)) for frame, _ in frames)


def listen(frames: Frames, settings: dict[str, Any]) -> Heard:
    """Return the samples, N and N m.

    Args:
        frames: of the log, in order.
        settings: address, else the one that is heard; full_scales: (6,) N and N m, else those that the log holds.

    Raises:
        UsageError: no stream is in it, or its full scales are not known.
    """
    address = _address(frames, settings)
    if address is None:
        raise UsageError("no stream of an IIT sensor is in it", todo="is its address right?")
    scales, said = _full_scales(frames, address, settings)
    pairs, lost = paired(frames, codec.layout(address))
    halves = [(pair[: len(pair) // 2], pair[len(pair) // 2 :]) for pair, _ in pairs]
    counts = [(*codec.decode_vector(force)[0], *codec.decode_vector(torque)[0]) for force, torque in halves]
    wrench = np.array(counts, dtype=float).reshape(-1, len(AXES)) * scales / codec.ZERO
    limited = np.array([len(force) == max(codec.LENGTHS) for force, _ in halves], dtype=bool)
    wrench[limited] = np.nan
    lost["a channel at its limit (left empty)"] = int(limited.sum())
    serial = _answers(frames, address, Command.GET_SERIAL_NUMBER)
    t_ns = np.array([t for _, t in pairs], dtype=np.int64)
    return Heard(t_ns, wrench, codec.decode_text(serial[-1]) if serial else "", said, lost)


def _address(frames: Frames, settings: dict[str, Any]) -> int | None:
    """Return the address given, or that of most forces whose torque comes next."""
    given = settings.get("address")
    return given if isinstance(given, int) else most_heard(frames, _sample_of)


def _sample_of(first: CanFrame, second: CanFrame) -> int | None:
    """Return the address of the board whose sample two frames may be."""
    address = first.arbitration_id >> 4 & 0xF
    ids = codec.stream_id(address, Stream.FORCE), codec.stream_id(address, Stream.TORQUE)
    fits = (first.arbitration_id, second.arbitration_id) == ids and len(first.data) == len(second.data)
    return address if fits and address != codec.HOST and len(first.data) in codec.LENGTHS else None


def _answers(frames: Frames, address: int, number: Command) -> list[bytes]:
    """Return the answers to a command that the log holds."""
    wanted, length = codec.answer_id(address), ANSWER_LENGTHS[number]
    data = (frame.data for frame, _ in frames if frame.arbitration_id == wanted)
    return [one for one in data if len(one) == length and one[0] == number]


def _full_scales(frames: Frames, address: int, settings: dict[str, Any]) -> tuple[npt.NDArray[np.float64], str]:
    """Return the full scales given, or those of the log, (6,) N and N m; and which, for people."""
    if "full_scales" in settings:
        given = settings["full_scales"]
        numbers = isinstance(given, list) and all(type(one) in (int, float) and one > 0.0 for one in given)
        if not numbers or len(given) != len(AXES):
            raise UsageError("not 6 positive numbers", where="can.full_scales", todo="three in N, then three in N m")
        return np.array(given, dtype=float), "full scales of the map"
    heard = {one[1]: codec.decode_full_scale(one) for one in _answers(frames, address, Command.GET_FULL_SCALE)}
    scales = [heard.get(channel, 0) for channel in range(len(AXES))]
    if not all(scales):
        what = "the log does not hold the sensor's full scales"
        todo = "log from before the daemon starts, or give can.full_scales (three in N, three in N m) in a map"
        raise UsageError(what, todo=todo)
    said = f"full scales from the log, {', '.join(map(str, scales[:3]))} N, {', '.join(map(str, scales[3:]))} N m"
    return np.array(scales, dtype=float), said
