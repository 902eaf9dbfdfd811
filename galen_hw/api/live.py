"""`Client` and `Subscriber`: the running daemon, found where the command line finds it."""

from collections.abc import Iterable
from pathlib import Path

from galen_hw import bus
from galen_hw.config.paths import Addresses, client_runtime_dir

QUEUE = bus.QUEUE_LENGTH


class Client(bus.CommandClient):
    """Sends requests to the running daemon: `with Client() as c: c.call("compensation", "status")`.

    Args:
        runtime: runtime directory of the daemon; the user's own, else the service's, if None.

    Raises:
        HardwareError: no daemon runs there.
        UsageError: this user may not command it.
    """

    def __init__(self, runtime: Path | str | None = None) -> None:
        addresses = _addresses(runtime)
        addresses.require_daemon()
        super().__init__(addresses.command)


class Subscriber(bus.Subscriber):
    """Receives what the running daemon publishes: `for topic, message in Subscriber(["wrench/compensated"]): ...`.

    A message is a struct with the fields of `docs/topics.md`; look at `valid` before it is used. What this end was too slow
    for is counted in `lost`, by topic.

    Args:
        topics: names, or beginnings of names ("wrench/"); everything if empty.
        runtime: runtime directory of the daemon; the user's own, else the service's, if None.
        address: ZeroMQ address instead, e.g. that of the copy for viewers on another machine.
        queue: messages kept while this end is busy.

    Raises:
        UsageError: this user may not connect there.
    """

    def __init__(
        self,
        topics: Iterable[str] = (),
        *,
        runtime: Path | str | None = None,
        address: str | None = None,
        queue: int = QUEUE,
    ) -> None:
        named = [topics] if isinstance(topics, str) else topics
        super().__init__(address or _addresses(runtime).bus, named, queue=queue)


def _addresses(runtime: Path | str | None) -> Addresses:
    return Addresses(client_runtime_dir() if runtime is None else Path(runtime))
