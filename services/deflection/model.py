"""The deflection model that serves: the saved file at work, bound to the robot and the tool in hand."""

from contextlib import suppress
from typing import TYPE_CHECKING, Final

import numpy as np

from galen_hw.config.tool_store import ToolStore
from galen_hw.errors import GalenError
from galen_hw.services.deflection.store import DeflectionFile, DeflectionStore
from galen_hw.services.service import ServiceContext

if TYPE_CHECKING:
    from galen_hw.identification.deflection.stream import GiveStream, Triple

TIP_TOLERANCE_M: Final = 1e-3
TOOL_SELECT: Final = "galen-hw tool select"
SWITCH_ON: Final = "galen-hw command compensation set_enabled enabled=true"
REFIT: Final = "galen-hw deflection fit DATA... --save NAME, or galen-hw deflection select NAME"


class ServedModel:
    """The model and the tool it serves.

    Args:
        context: robot and state directory; chosen: name of the model, empty for the selected one.
    """

    def __init__(self, context: ServiceContext, chosen: str = "") -> None:
        self._context, self._chosen = context, chosen
        self.file: DeflectionFile | None = None
        self.stream: GiveStream | None = None
        self.problem, self.todo = "", ""
        """Why no corrected pose can be valid, and what to do; empty when nothing is wrong."""
        self.tool = self.asked = self._unknown = ""
        self.tip: Triple = (0.0, 0.0, 0.0)
        with suppress(GalenError):  # The compensation says what is wrong with the tools.
            self._take(ToolStore(context.state_dir, virtual=context.virtual).selected() or "")
        try:
            self.load()
        except GalenError as error:
            self.problem, self.todo = error.problem, error.todo

    @property
    def id(self) -> str:
        """Of the model's file; empty without one."""
        return "" if self.file is None else self.file.id

    def load(self) -> None:
        """Read the model again.

        Raises:
            UsageError: its file is damaged; the model that was read before stays.
        """
        store, found, stream = DeflectionStore(self._context.state_dir), None, None
        name = self._chosen or store.selected()
        if name is not None:
            # Fitting and its numerics take a second to import: a service without a model does not wait for them.
            from galen_hw.identification.deflection.table import model_of

            found = store.load(name)
            std = np.array(found.std) if found.std else None
            stream = model_of(found.model, found.values).stream(std)
        self.file, self.stream = found, stream
        self._bind()

    def take_tool(self, name: str) -> None:
        """Another tool is in hand; of one that is not known the pose is the sensor's own, and nothing is corrected."""
        self.asked, self._unknown = name, ""
        try:
            self._take(name)
        except GalenError as error:
            self._unknown = f"tool {name!r}: {error.what}"
            self.tool, self.tip = "", (0.0, 0.0, 0.0)
        if self.stream is not None:
            self.stream.reset()
        self._bind()

    def _take(self, name: str) -> None:
        self.tip = (
            (0.0, 0.0, 0.0)
            if not name
            else ToolStore(self._context.state_dir, virtual=self._context.virtual).load(name).tip
        )
        self.tool = self.asked = name

    def _bind(self) -> None:
        """A model of another robot or tool must not be used."""
        self.problem, self.todo = "", ""
        file, robot = self.file, self._context.robot.name
        if file is None:
            return
        if self._unknown:
            self.problem = self._unknown
        elif file.robot != robot:
            self.problem = f"model {file.id} is of robot {file.robot!r}, this is {robot!r}"
        elif file.virtual and self._context.virtual is False:
            self.problem = f"model {file.id} was fitted on a virtual robot, this is a real one"
        elif file.tool and file.tool != self.tool:
            self.problem = f"model {file.id} is of tool {file.tool!r}, in hand is {self.tool or 'no tool'!r}"
        elif file.tip is not None and np.linalg.norm(np.subtract(file.tip, self.tip)) > TIP_TOLERANCE_M:
            self.problem = f"model {file.id} was fitted for a tip at {file.tip} m, the tool's is at {self.tip} m"
        other_tool = file.tool and file.tool != self.tool and file.robot == robot
        other_tool = other_tool and not (file.virtual and self._context.virtual is False)
        self.todo = "" if not self.problem else self._tool_todo(file.tool) if other_tool else REFIT

    def _tool_todo(self, tool: str) -> str:
        """What brings the model's tool in hand: another fit does not help."""
        store = ToolStore(self._context.state_dir, virtual=self._context.virtual)
        with suppress(GalenError):
            if steps := steps_to_hold(store, tool):
                return ", then ".join(steps)
        return f"{TOOL_SELECT} {tool}, and {SWITCH_ON} if the compensation is off"


def steps_to_hold(store: ToolStore, tool: str) -> list[str]:
    """The commands that are missing until the daemon compensates a tool, as they are typed; none if it is selected.

    Args:
        store: of the kind of hardware, virtual or real, that is meant.

    Raises:
        UsageError: the store is damaged.
    """
    if not store.load(tool).calibrated:
        return [f"galen-hw calibrate --tool {tool}", f"{TOOL_SELECT} {tool}"]
    return [] if store.selected() == tool else [f"{TOOL_SELECT} {tool}"]
