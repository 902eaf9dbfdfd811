"""The web server of the dashboard: one page, one websocket, the reports. Starlette on uvicorn, a process apart from the loop."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from galen_hw.errors import GalenError, HardwareError
from galen_hw.tools.dashboard import frames
from galen_hw.tools.dashboard.access import Access
from galen_hw.tools.dashboard.actions import Actions, report_file, reports, tools
from galen_hw.tools.dashboard.calibration import Calibration
from galen_hw.tools.dashboard.feed import Feed

STATIC: Final = Path(__file__).with_name("static")
FRAME_S: Final = 0.1
"""A screen that may stand on the robot's own computer: ten pictures a second, and the rest of the machine for the robot."""
SLOW_S: Final = 1.0
MOST_PAGES: Final = 16
MOST_REFUSALS: Final = 5
"""Frames of a page that are not what they should be, wrong tokens among them, before it is sent away."""
FRAMES_A_SECOND: Final = 30
REFUSED, FULL, ABUSED = 4403, 4429, 4400
PAGE_RULES: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
REPORT_RULES: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; sandbox allow-popups"


class Guard:
    """Answers only to the server's own names, and gives every answer the headers that keep a browser careful."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See the class."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        host = next((value.decode("latin-1") for key, value in scope["headers"] if key == b"host"), "")
        if not self._access.knows(host):
            await PlainTextResponse("not under this name", 403)(scope, receive, send)
            return
        rules = REPORT_RULES if scope["path"].startswith("/reports/") else PAGE_RULES
        more = [
            (b"content-security-policy", rules.encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"cache-control", b"no-cache"),
        ]

        async def careful(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *more]
            await send(message)

        await self._app(scope, receive, careful)


@dataclass(eq=False)
class Page:
    """One open page: what it has been sent, and what it has done."""

    websocket: WebSocket
    bins: int = 0
    faults: int = -1
    calibration: int = -1
    may_command: bool = False
    refusals: int = 0
    slow_s: float = 0.0
    times: list[float] = field(default_factory=list)
    doing: set["asyncio.Task[None]"] = field(default_factory=set)
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def send(self, content: Any) -> None:
        """Send one object; NaN becomes null."""
        async with self.lock:
            await self.websocket.send_text(msgspec.json.encode(content).decode())


class Dashboard:
    """The application.

    Args:
        feed: what is shown; actions, calibration: what is done; access: who may.
    """

    def __init__(self, feed: Feed, actions: Actions, calibration: Calibration, access: Access) -> None:
        self._feed, self._actions, self._calibration, self._access = feed, actions, calibration, access
        self._pages = 0
        self.app = Starlette(
            routes=[
                Route("/", lambda _: FileResponse(STATIC / "index.html")),
                Route("/reports/{folder}/{name}", self._report),
                WebSocketRoute("/live", self._live),
                Mount("/static", StaticFiles(directory=STATIC)),
            ],
            middleware=[Middleware(Guard, access=access)],
            lifespan=self._lifespan,
        )

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        yield
        await asyncio.to_thread(self._calibration.close)

    async def _report(self, request: Request) -> Response:
        words = request.path_params
        path = await asyncio.to_thread(report_file, self._feed.info, words["folder"], words["name"])
        return PlainTextResponse("no such report", 404) if path is None else FileResponse(path)

    async def _live(self, websocket: WebSocket) -> None:
        if not self._access.is_own(websocket.headers.get("origin"), websocket.headers.get("host")):
            await websocket.close(REFUSED)
            return
        await websocket.accept()
        if self._pages >= MOST_PAGES:
            await websocket.close(FULL, "too many pages are open")
            return
        page = Page(websocket)
        self._pages += 1
        self._feed.open()
        sender = asyncio.create_task(self._send_all(page))
        try:
            await page.send({"type": "welcome", "can_command": bool(self._access.token)})
            await self._receive_all(page)
        except (WebSocketDisconnect, RuntimeError):
            pass  # RuntimeError: Starlette's word for a send after the close
        finally:
            sender.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender
            self._feed.close()
            self._pages -= 1

    async def _send_all(self, page: Page) -> None:
        feed = self._feed
        while True:
            await asyncio.sleep(FRAME_S)
            live = await asyncio.to_thread(feed.live)
            rows, count = feed.bins.since(page.bins), feed.bins.count
            page.bins = count
            await page.send(live | {"bins": rows})
            if page.calibration != self._calibration.count:
                page.calibration = self._calibration.count
                await page.send({"type": "calibration"} | self._calibration.state)
            if page.faults != feed.fault_count:
                page.faults = feed.fault_count
                await page.send({"type": "faults", "faults": feed.faults})
            if time.monotonic() - page.slow_s > SLOW_S:
                page.slow_s = time.monotonic()
                for slow in await asyncio.to_thread(self._slow):
                    await page.send(slow)

    def _slow(self) -> list[dict[str, Any]]:
        info = self._feed.info
        shown = ("robot", "virtual", "version", "ready", "devices", "services")
        about = {"type": "about", "daemon": bool(info)} | {k: info.get(k) for k in shown}
        lists = {"type": "lists", "tools": tools(info), "reports": reports(info)}
        health = self._feed.health()
        return [about, lists, *([health] if health is not None else [])]

    async def _receive_all(self, page: Page) -> None:
        while True:
            text = await page.websocket.receive_text()
            now = time.monotonic()
            page.times = [t for t in page.times if t > now - 1.0] + [now]
            try:
                frame = frames.read_frame(text)
            except frames.FrameError as error:
                page.refusals += 1
                await page.send({"type": "answer", "n": None, "ok": False, "text": f"not a frame: {error}"})
            else:
                await self._take(page, frame)
            if page.refusals >= MOST_REFUSALS or len(page.times) > FRAMES_A_SECOND:
                await page.websocket.close(ABUSED, "that was no page of ours")
                return

    async def _take(self, page: Page, frame: frames.Frame) -> None:
        match frame:
            case frames.Hello(token=token):
                page.may_command = self._access.allows(token)
                page.refusals += not page.may_command
                text = "" if page.may_command else "this token is not the dashboard's: you may look"
                await page.send({"type": "hello", "n": frame.n, "ok": page.may_command, "text": text})
            case frames.Alive():
                self._calibration.alive(page)
            case _ if not page.may_command:
                text = "this page may only look: open the address that galen-hw dashboard printed"
                await page.send({"type": "answer", "n": frame.n, "ok": False, "text": text})
            case _:
                # Beside what else this page does: a stop must not wait for the answer to a tare.
                task = asyncio.create_task(self._do(page, frame))
                page.doing.add(task)
                task.add_done_callback(page.doing.discard)

    async def _do(self, page: Page, frame: frames.Frame) -> None:
        try:
            text, ok = await asyncio.to_thread(self._actions.carry_out, frame, page), True
        except GalenError as error:
            text, ok = f"{error.what}{f' ({error.todo})' if error.todo else ''}", False
        with suppress(WebSocketDisconnect, RuntimeError):
            await page.send({"type": "answer", "n": frame.n, "ok": ok, "text": text})


def make_server(app: Any) -> uvicorn.Server:
    """The server of the application: small frames, few connections, nothing said of itself."""
    return uvicorn.Server(
        uvicorn.Config(
            app,
            ws="websockets-sansio",
            ws_max_size=frames.LARGEST_FRAME,
            ws_ping_interval=5.0,
            ws_ping_timeout=10.0,
            limit_concurrency=4 * MOST_PAGES,
            log_level="warning",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=3,
        )
    )


def listen(host: str, port: int) -> tuple[socket.socket, str]:
    """A listening socket and the page's address.

    Raises:
        HardwareError: the port cannot be had.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family, backlog=64)
    except OSError as error:
        todo = "give another one with --port"
        raise HardwareError(f"cannot listen ({error.strerror or error})", where=f"{host}:{port}", todo=todo) from None
    name = f"[{host}]" if ":" in host else host
    return listener, f"http://{name}:{listener.getsockname()[1]}/"
