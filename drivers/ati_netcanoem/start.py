"""How the ATI NETCANOEM board is identified: the questions before the first sample, and what the answers must hold."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.ati_netcanoem import codec
from galen_hw.drivers.ati_netcanoem.codec import Op
from galen_hw.drivers.ati_netcanoem.sampler import Sampler
from galen_hw.drivers.dialogue import DialogueError, Expect, Fence, Query
from galen_hw.units import FORCE_TO_NEWTON, TORQUE_TO_NEWTON_METRE


class AtiSettings(BaseModel):
    """Keys of an `ati_netcanoem` device.

    Args:
        rate_hz: samples asked for a second; the wire carries 819, 1639, 3278 a second at 250 k, 500 k, 1 Mbit/s.
        base_id: seven bits; 0x20 with the board's DIP switch 1 on.
        calibration_slot: which of the board's 16 calibrations to use.
        serial_number: refuse any other sensor; none accepts what answers.
        reset_at_start: reset the board before anything else (its selection of a calibration is lost, and made again).
        reset_wait_s: how long a reset board is left in peace.
        reply_timeout_s: after this a sample is given up; `start_timeout_s`: the same for a question of the start.
        silent_s: a board that answers nothing for so long is gone: a fault, and it is identified anew. The samples of
            the silence are lost and marked as such long before that; see `sampler.Sampler` for what is counted.
        tries: how often a question is asked before a fault; `retry_s`: pause before the start is tried again.
        counts_per_force, counts_per_torque, force_unit, torque_unit: instead of what the board says; firmware before
            3.7 cannot say: it is then 1 000 000, N and N-m.
        zero_samples: samples averaged by `zero` unless the request says otherwise.
        zero_kept_s: a restarted daemon goes on with the zero it had if the sensor was out of its sight for no longer.
        bus_error_s: the board's CAN error bit must stay this long before it is reported (it never makes data invalid).
        verify_repeats: a sample equal to the last one bit by bit may be its double: check before it is published.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    rate_hz: float = Field(default=1000.0, gt=0.0, le=3278.0)
    base_id: int = Field(default=0x20, ge=0, le=0x7F)
    calibration_slot: int = Field(default=0, ge=0, le=15)
    serial_number: str | None = None
    reset_at_start: bool = False
    reset_wait_s: float = Field(default=0.1, ge=0.0, le=10.0)
    reply_timeout_s: float = Field(default=0.02, gt=0.0, le=10.0)
    silent_s: float = Field(default=1.0, gt=0.0, le=60.0)
    start_timeout_s: float = Field(default=0.1, gt=0.0, le=10.0)
    tries: int = Field(default=3, ge=1, le=100)
    retry_s: float = Field(default=1.0, gt=0.0, le=60.0)
    counts_per_force: int | None = Field(default=None, gt=0)
    counts_per_torque: int | None = Field(default=None, gt=0)
    force_unit: Literal["lbf", "N", "klbf", "kN", "kgf", "gf"] | None = None
    torque_unit: Literal["lbf-in", "lbf-ft", "N-m", "N-mm", "kgf-cm", "kN-m"] | None = None
    zero_samples: int = Field(default=500, ge=1, le=1_000_000)
    zero_kept_s: float = Field(default=60.0, ge=0.0, le=86400.0)
    bus_error_s: float = Field(default=1.0, ge=0.0)
    verify_repeats: bool = True


@dataclass(frozen=True)
class AtiIdentity:
    """What the start found out.

    Args:
        firmware: major, minor, build; `firmware_bytes`, `serial_bytes`: as received, to recognise the same board again.
        serial_number: of the sensor.
        matrix: (6, 6), gauges 0 to 5 in counts to N and N m.
        units: what the board counts in, for people.
    """

    firmware: tuple[int, int, int]
    firmware_bytes: bytes
    serial_number: str
    serial_bytes: bytes
    matrix: npt.NDArray[np.float64]
    units: str

    @property
    def described(self) -> str:
        """For people."""
        return f"sensor {self.serial_number}, firmware {'.'.join(map(str, self.firmware))}, {self.units}"

    @property
    def answers(self) -> dict[int, bytes]:
        """What this board answers to the questions of a fence, by opcode."""
        return {int(Op.FIRMWARE): self.firmware_bytes, int(Op.SERIAL_NUMBER): self.serial_bytes}


def new_sampler(settings: AtiSettings, fence: Fence, answers: dict[int, bytes], counters: dict[str, int]) -> Sampler:
    """The sampler of a device with these settings."""
    return Sampler(
        ask=codec.request(settings.base_id, Op.SAMPLE),
        fence=fence,
        answers=answers,
        period_ns=round(NS_PER_S / settings.rate_hz),
        timeout_ns=round(settings.reply_timeout_s * NS_PER_S),
        silent_ns=round(settings.silent_s * NS_PER_S),
        verify_repeats=settings.verify_repeats,
        counters=counters,
    )


def query(settings: AtiSettings, name: str, op: Op, *lengths: int, data: bytes = b"") -> Query:
    """The question `op`, whose answer has frames of these lengths under successive opcodes."""
    request = codec.request(settings.base_id, op, data)
    answer = tuple(Expect(request.arbitration_id + place, length) for place, length in enumerate(lengths))
    return Query(name, request, answer)


def fence(settings: AtiSettings) -> Fence:
    """Two harmless questions with identifiers of their own, lower in priority than a sample's."""
    return Fence(
        (
            query(settings, "the firmware version", Op.FIRMWARE, 4),
            query(settings, "the serial number", Op.SERIAL_NUMBER, 8),
        )
    )


def identify(settings: AtiSettings, loops_back: Callable[[], bool]) -> Generator[Query, bytes, AtiIdentity]:
    """The conversation of the start (manual, chapter 10).

    Args:
        settings: of the device.
        loops_back: whether the wire has shown us our own requests; the request to select looks like its answer.

    Raises:
        DialogueError: an answer that cannot be used.
    """
    if settings.reset_at_start:
        reset = codec.request(settings.base_id, Op.RESET)
        yield Query("reset", reset, wait_ns=round(settings.reset_wait_s * NS_PER_S))
    firmware_bytes = yield query(settings, "the firmware version", Op.FIRMWARE, 4)
    firmware = codec.decode_firmware(firmware_bytes)
    serial_bytes = yield query(settings, "the serial number", Op.SERIAL_NUMBER, 8)
    serial_number = codec.decode_serial_number(serial_bytes)
    if settings.serial_number not in (None, serial_number):
        raise DialogueError(
            f"sensor {serial_number} answers, but sensor {settings.serial_number} is configured",
            "connect the right sensor or change its serial_number in the configuration",
        )
    yield from _select(settings, loops_back)
    rows = yield from _matrix(settings)
    counts, units = yield from _counts_and_units(settings, firmware)
    to_si = FORCE_TO_NEWTON[units[0]], TORQUE_TO_NEWTON_METRE[units[1]]
    matrix = codec.si_matrix(rows, counts, to_si)
    described = f"{counts[0]} counts/{units[0]}, {counts[1]} counts/{units[1]}"
    return AtiIdentity(firmware, firmware_bytes, serial_number, serial_bytes, matrix, described)


def _select(settings: AtiSettings, loops_back: Callable[[], bool]) -> Generator[Query, bytes, None]:
    """Select the calibration and check its echo; on a wire that shows our own frames the second one is the echo."""
    slot = settings.calibration_slot
    request = codec.request(settings.base_id, Op.SELECT_CALIBRATION, bytes([slot]))
    echo = Expect(request.arbitration_id, 1)
    data = yield Query("the selection of a calibration", request, (echo, echo) if loops_back() else (echo,))
    if set(data) != {slot}:
        raise DialogueError(
            f"calibration slot {slot} was asked for, slot {data[-1]} was selected",
            "choose a calibration_slot that the board has",
        )


def _matrix(settings: AtiSettings) -> Generator[Query, bytes, npt.NDArray[np.float64]]:
    """The six rows, read twice: a row carries no number, and a wrong one would be wrong for ever."""
    first = yield from _matrix_once(settings)
    second = yield from _matrix_once(settings)
    if first != second:
        raise DialogueError("two readings of the calibration matrix differ", "check the CAN wiring and termination")
    rows = np.array([codec.decode_matrix_row(row) for row in first])
    if not np.isfinite(rows).all() or np.linalg.matrix_rank(rows) < codec.GAUGES:
        raise DialogueError(
            f"the matrix of calibration slot {settings.calibration_slot} cannot be used (singular or not finite)",
            "choose a calibration_slot that holds a calibration",
        )
    return rows


def _matrix_once(settings: AtiSettings) -> Generator[Query, bytes, list[bytes]]:
    rows: list[bytes] = []
    for axis, name in enumerate(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")):
        ask = query(settings, f"the matrix row {name}", Op.MATRIX_ROW, 8, 8, 8, data=bytes([axis]))
        rows.append((yield Query(ask.name, ask.request, ask.answer, numbered=False, unlike=rows[-1] if rows else b"")))
    return rows


def _counts_and_units(
    settings: AtiSettings, firmware: tuple[int, int, int]
) -> Generator[Query, bytes, tuple[tuple[int, int], tuple[str, str]]]:
    counts = codec.DEFAULT_COUNTS_PER_UNIT, codec.DEFAULT_COUNTS_PER_UNIT
    units = "N", "N-m"
    if firmware[:2] >= codec.COUNTS_SINCE:
        counts = codec.decode_counts_per_unit((yield query(settings, "the counts per unit", Op.COUNTS_PER_UNIT, 8)))
        data = yield query(settings, "the unit codes", Op.UNIT_CODES, 2)
        units = _units(data, settings)
    counts = settings.counts_per_force or counts[0], settings.counts_per_torque or counts[1]
    if 0 in counts:
        raise DialogueError(
            "the board gives 0 counts per unit", "choose another calibration_slot or set counts_per_force and _torque"
        )
    return counts, (settings.force_unit or units[0], settings.torque_unit or units[1])


def _units(data: bytes, settings: AtiSettings) -> tuple[str, str]:
    try:
        return codec.decode_unit_codes(data)
    except KeyError as unknown:
        if settings.force_unit and settings.torque_unit:
            return settings.force_unit, settings.torque_unit
        raise DialogueError(
            f"unknown unit code {unknown} (force, torque: {data[0]}, {data[1]})",
            "set force_unit and torque_unit in the configuration",
        ) from None
