"""From a line to the controller's answer: each command is carried out and gets its own `:` or `?`."""

from typing import Final

from galen_hw.drivers.virtual.galil_dmc.controller import Controller
from galen_hw.drivers.virtual.galil_dmc.expression import evaluate
from galen_hw.drivers.virtual.galil_dmc.format import Rejected
from galen_hw.drivers.virtual.galil_dmc.grammar import LINE_LIMIT, Line, parse, split_line
from galen_hw.drivers.virtual.galil_dmc.motion import MOTION, Handler
from galen_hw.drivers.virtual.galil_dmc.registers import SETTINGS
from galen_hw.drivers.virtual.galil_dmc.tell import REPORTS, operand

COMMANDS: Final[dict[str, Handler]] = MOTION | SETTINGS | REPORTS
_ONLY_IN_PROGRAMS: Final = {"WT", "AM", "EN", "JP", "JS", "NO", "AD", "AP", "AR", "AS", "TZ"}


class Interpreter:
    """Carries out lines on a controller.

    Args:
        controller: what the commands act on.
    """

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        controller.program.execute = self._execute
        controller.evaluate = lambda text: evaluate(text, lambda part: operand(controller, part))

    def answer(self, line: Line) -> bytes:
        """Everything the controller says to one line, without its echo."""
        if self.controller.downloading:
            return self._download(line)
        if line.overflowed:
            return self._refuse(5)
        out = b""
        for text in split_line(line.text):
            out += self._one(text)
            if self.controller.downloading or self.controller.reset_requested:
                break
        return out

    def _one(self, text: str) -> bytes:
        try:
            data = self._execute(text)
        except Rejected as rejected:
            return self._refuse(rejected.code)
        if self.controller.downloading:
            return b""  # DL's own colon is deferred to the end of the download.
        if data is None:
            return b":"
        return data + b":" if isinstance(data, bytes) else data.encode("latin-1") + b"\r\n:"

    def _execute(self, text: str) -> str | bytes | None:
        command = parse(text)
        if command is None:
            return None
        if command.variable:
            return self._variable(command.name, command.rest)
        handler = COMMANDS.get(command.name)
        if handler is None:
            raise Rejected(2 if command.name in _ONLY_IN_PROGRAMS else 1)
        return handler(self.controller, command.rest)

    def _variable(self, name: str, rest: str) -> str | None:
        if rest in {"", "?"}:
            if name not in self.controller.variables:
                raise Rejected(1)
            return self.controller.tell_variables([self.controller.variables[name]])
        self.controller.variables[name] = self.controller.value(rest)
        return None

    def _refuse(self, code: int) -> bytes:
        self.controller.error_code = code
        return b"?"

    def _download(self, line: Line) -> bytes:
        if line.overflowed or len(line.text) > LINE_LIMIT:
            self._refuse(60)
            return b"?"
        if not self.controller.program.receive(line.text):
            return b""
        self.controller.downloading = False
        return b"::"
