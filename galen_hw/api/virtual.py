"""`virtual_robot`: a whole robot without hardware, daemon and all, for the time of a `with` block."""

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from galen_hw.api.live import Client, Subscriber
from galen_hw.config.tool_file import ToolFile
from galen_hw.drivers.virtual.control import VirtualControl


@dataclass(frozen=True)
class LiveRobot:
    """A virtual robot with its daemon.

    Args:
        runtime: directory of the daemon's sockets, for `--dir` of the commands.
        state: directory of its tools and calibrations.
        control: changes the virtual world: `push`, `attach_tool`, `fault`, ... (`docs/virtual.md`).
    """

    runtime: Path
    state: Path
    control: VirtualControl

    def client(self) -> Client:
        """Return a client that sends requests to the daemon; close it, or use `with`."""
        return Client(self.runtime)

    def subscriber(self, topics: Iterable[str] = ()) -> Subscriber:
        """Return a subscriber to what the daemon publishes; close it, or use `with`."""
        return Subscriber(topics, runtime=self.runtime)


@contextmanager
def virtual_robot(
    *,
    tool: ToolFile | None = None,
    config: Path | str | None = None,
    runtime: Path | str | None = None,
    state: Path | str | None = None,
) -> Iterator[LiveRobot]:
    """Run the virtual robot and the daemon beside it until the block ends; the same drivers as on the real robot.

    The wires alone, without a daemon, are `galen_hw.drivers.virtual.start.virtual_robot`.

    Args:
        tool: a calibrated tool to know and to compensate from the start; else none is calibrated.
        config: settings; the default ones if None.
        runtime: for the sockets; a temporary directory if None.
        state: for tools and calibrations; a temporary directory if None, so that nothing of the user's is touched.

    Raises:
        HardwareError: the daemon did not become ready; its own lines on stderr say why.
        UsageError: the tool is not calibrated.
    """
    from galen_hw.config.tool_store import ToolStore
    from galen_hw.daemon.session import own_daemon

    with tempfile.TemporaryDirectory(prefix="galen-hw-state-") as temporary:
        kept = Path(state or temporary)
        if tool is not None:
            store = ToolStore(kept, virtual=True)
            store.save(tool.on_virtual())
            store.select(tool.name)
        settings = None if config is None else str(config)
        where = None if runtime is None else Path(runtime)
        with (
            own_daemon(config=settings, virtual=True, runtime=where, state=kept) as addresses,
            VirtualControl(addresses.virtual) as control,
        ):
            yield LiveRobot(addresses.runtime, kept, control)
