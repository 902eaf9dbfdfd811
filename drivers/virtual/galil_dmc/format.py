"""How the controller writes numbers, and what it says of a rejected command."""

from typing import Final

ERROR_TEXTS: Final = {
    1: "Unrecognized command",
    2: "Command only valid from program",
    3: "Command not valid in program",
    4: "Operand error",
    5: "Input buffer full",
    6: "Number out of range",
    7: "Command not valid while running",
    8: "Command not valid while not running",
    9: "Variable error",
    10: "Empty program line or undefined label",
    11: "Invalid label or line number",
    13: "JG only valid when running in jog mode",
    17: "ED, BN and DL not valid while program running",
    19: "Application strand already executing",
    20: "Begin not valid with motor off",
    21: "Begin not valid while running",
    22: "Begin not possible due to Limit Switch",
    50: "Not enough fields",
    51: "Question mark not valid",
    52: 'Missing " or string too long',
    55: "Missing [ or []",
    57: "Bad function or array",
    58: "Bad command response (i.e._GNX)",
    60: "Download error - line too long or too many lines",
}


class Rejected(Exception):  # noqa: N818  an answer, not a failure of this program
    """A command that is answered with `?`.

    Args:
        code: what TC will say.
    """

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def error_text(code: int) -> str:
    """What `TC 1` returns."""
    return f"{code} {ERROR_TEXTS.get(code, 'Unknown error')}" if code else "0"


def digits(value: float, whole: int, fraction: int, *, leading_zeros: bool) -> tuple[str, str]:
    """Sign (`-` or a space) and digits of a number in format whole.fraction.

    A number that does not fit is shown as nines; LZ 0 keeps the leading zeros.
    """
    scale = 10**fraction
    scaled = round(abs(value) * scale)
    if scaled >= 10 ** (whole + fraction):
        scaled = 10 ** (whole + fraction) - 1
    head, tail = divmod(scaled, scale)
    text = f"{head:0{whole}d}" if leading_zeros else str(head)
    if fraction:
        text += f".{tail:0{fraction}d}"
    return ("-" if value < 0 and scaled else " "), text


def positions(values: list[float], whole: int, fraction: int, *, leading_zeros: bool) -> str:
    """Values of a tell command or of `?`: `-9, 5, 0, 7`, or with leading zeros ` 0000000021,-0000000009`."""
    parts = [digits(value, whole, fraction, leading_zeros=leading_zeros) for value in values]
    if leading_zeros:
        return ",".join(sign + text for sign, text in parts)
    return ", ".join((sign + text).strip() for sign, text in parts)


def message_numbers(values: list[float], whole: int, fraction: int, *, leading_zeros: bool) -> str:
    """Values of MG: ` 1.0000 0.0000`, one space between them."""
    parts = [digits(value, whole, fraction, leading_zeros=leading_zeros) for value in values]
    return " ".join((sign + text).strip() if i else sign + text for i, (sign, text) in enumerate(parts))
